"""Signed distances from points to a closed mesh, and points moved out of it.

The sign is that of the winding number, which a ray to +z counts exactly: the sum of the
orientations of the triangles that it crosses.  A grid over x and y holds the triangles above each
cell.  Distances come from the tree of :mod:`ssdr.kernels.closest`.

A pose of the body is passed as one tuple, `scene`:

vertices   (V, 3)                   float64
triangles  (T, 3)                   int32    in the tree's order
depth                               int      levels of the tree
boxes      (2**(depth + 1) - 1, 6)  float64
origin     (2,)                     float64  lower corner of the grid
scale                               float64  cells a metre
columns, rows                       int      of the grid
starts     (columns * rows + 1,)    int64    first item of each cell
items      (n,)                     int32    triangles of the cells, cell after cell
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ssdr.kernels.policy import inline, kernel

# Metres; what a point must gain for a step to count, and how far within the margin it may be.
_GAIN = 1e-6
# Metres above a point of the skin where it is asked whether the skin is free there.
_ABOVE = 1e-5
_STEPS = 24


@inline
def _closest(px, py, pz, a, b, c):
    """Squared distance to a triangle and its closest point (Ericson 2005, section 5.1.5)."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = px - a[0], py - a[1], pz - a[2]
    d1 = ux * wx + uy * wy + uz * wz
    d2 = vx * wx + vy * wy + vz * wz
    uu = ux * ux + uy * uy + uz * uz
    uv = ux * vx + uy * vy + uz * vz
    vv = vx * vx + vy * vy + vz * vz
    d3, d4 = d1 - uu, d2 - uv
    d5, d6 = d1 - uv, d2 - vv
    vc = d1 * d4 - d3 * d2
    vb = d5 * d2 - d1 * d6
    va = d3 * d6 - d5 * d4
    s, t = 0.0, 0.0
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        s = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        s = d1 / (d1 - d3)
    elif d6 >= 0.0 and d5 <= d6:
        t = 1.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        s = 1.0 - t
    else:
        s, t = vb / (va + vb + vc), vc / (va + vb + vc)
    x, y, z = a[0] + s * ux + t * vx, a[1] + s * uy + t * vy, a[2] + s * uz + t * vz
    return (px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2, x, y, z


@inline
def _gap(px, py, pz, box):
    """Squared distance to a box."""
    x = max(0.0, max(box[0] - px, px - box[3]))
    y = max(0.0, max(box[1] - py, py - box[4]))
    z = max(0.0, max(box[2] - pz, pz - box[5]))
    return x * x + y * y + z * z


@inline
def _crossing(px, py, a, b):
    """±1 if the edge passes the ray from the point to +x, upwards or downwards; else 0.

    It is computed from the lower end to the upper one, so that the two triangles of an edge agree
    to the last bit and no ray slips between them.
    """
    if (a[1] > py) == (b[1] > py):
        return 0
    low, high, sign = a, b, 1
    if a[1] > b[1]:
        low, high, sign = b, a, -1
    x = low[0] + (py - low[1]) / (high[1] - low[1]) * (high[0] - low[0])
    return sign if x > px else 0


@inline
def winding(px, py, pz, scene):
    """The winding number of the mesh about a point."""
    vertices, triangles, _, _, origin, scale, columns, rows, starts, items = scene
    x, y = (px - origin[0]) * scale, (py - origin[1]) * scale
    if not (0.0 <= x < columns and 0.0 <= y < rows):
        return 0
    cell = int(y) * columns + int(x)
    total = 0
    for k in range(starts[cell], starts[cell + 1]):
        t = items[k]
        a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
        side = _crossing(px, py, a, b) + _crossing(px, py, b, c) + _crossing(px, py, c, a)
        if side == 0:
            continue
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        volume = (
            (px - a[0]) * (uy * vz - uz * vy)
            + (py - a[1]) * (uz * vx - ux * vz)
            + (pz - a[2]) * (ux * vy - uy * vx)
        )
        # Below the triangle: behind it if it faces up, before it if it faces down.
        if volume * side < 0.0:
            total += side
    return total


@inline
def _nearest(px, py, pz, limit, hint, free, scene, nodes, gaps):
    """Squared distance, triangle (−1: none nearer than `limit`, squared) and closest point.

    With `free`, points of the skin that another part of the body covers do not count.
    """
    vertices, triangles, depth, boxes = scene[0], scene[1], scene[2], scene[3]
    count, base = len(triangles), (1 << depth) - 1
    best, which, cx, cy, cz = limit, -1, px, py, pz
    if hint >= 0 and not free:
        h = triangles[hint]
        d, x, y, z = _closest(px, py, pz, vertices[h[0]], vertices[h[1]], vertices[h[2]])
        if d < best:
            best, which, cx, cy, cz = d, hint, x, y, z
    nodes[0], gaps[0], top = 0, _gap(px, py, pz, boxes[0]), 1
    while top > 0:
        top -= 1
        if gaps[top] >= best:
            continue
        node = nodes[top]
        if node >= base:
            j = node - base
            for t in range((count * j) >> depth, (count * (j + 1)) >> depth):
                h = triangles[t]
                d, x, y, z = _closest(px, py, pz, vertices[h[0]], vertices[h[1]], vertices[h[2]])
                if d < best:
                    if free and d > 0.0:
                        f = 1.0 + _ABOVE / np.sqrt(d)
                        qx, qy, qz = px + f * (x - px), py + f * (y - py), pz + f * (z - pz)
                        if winding(qx, qy, qz, scene) > 0:
                            continue
                    best, which, cx, cy, cz = d, t, x, y, z
            continue
        left, right = 2 * node + 1, 2 * node + 2
        near, far = _gap(px, py, pz, boxes[left]), _gap(px, py, pz, boxes[right])
        if near > far:
            left, right, near, far = right, left, far, near
        if far < best:
            nodes[top], gaps[top] = right, far
            top += 1
        if near < best:
            nodes[top], gaps[top] = left, near
            top += 1
    return best, which, cx, cy, cz


@inline
def _signed(px, py, pz, margin, hint, scene, nodes, gaps):
    """Signed distance (inf: outside and farther than the margin), triangle, closest point."""
    inside = winding(px, py, pz, scene) > 0
    limit = np.inf if inside else margin * margin
    d, which, x, y, z = _nearest(px, py, pz, limit, hint, False, scene, nodes, gaps)
    if which < 0:
        return np.inf, which, x, y, z
    return (-np.sqrt(d) if inside else np.sqrt(d)), which, x, y, z


@inline
def _move_out(px, py, pz, margin, farthest, hint, scene, nodes, gaps):
    """The point moved out to the margin, or as far as it goes; with its signed distance."""
    s, which, x, y, z = _signed(px, py, pz, margin, hint, scene, nodes, gaps)
    for _ in range(_STEPS):
        if s >= margin - _GAIN:
            break
        inside, d = s < 0.0, abs(s)
        if inside:
            ux, uy, uz = (x - px) / d, (y - py) / d, (z - pz) / d
            covered = winding(x + _ABOVE * ux, y + _ABOVE * uy, z + _ABOVE * uz, scene) > 0
            if covered:
                square, other, x, y, z = _nearest(
                    px, py, pz, farthest * farthest, -1, True, scene, nodes, gaps
                )
                if other < 0 or square == 0.0:
                    break
                d = np.sqrt(square)
                ux, uy, uz = (x - px) / d, (y - py) / d, (z - pz) / d
        elif d > 0.0:
            ux, uy, uz = (px - x) / d, (py - y) / d, (pz - z) / d
        else:
            h = scene[1][which]
            a, b, c = scene[0][h[0]], scene[0][h[1]], scene[0][h[2]]
            normal = np.cross(b - a, c - a)
            length = np.sqrt((normal * normal).sum())
            if length == 0.0:
                break
            ux, uy, uz = normal[0] / length, normal[1] / length, normal[2] / length
        # The full margin does not fit between two parts of the body that nearly touch.
        step, better = margin, False
        for _ in range(5):
            qx, qy, qz = x + step * ux, y + step * uy, z + step * uz
            r, on, rx, ry, rz = _signed(qx, qy, qz, margin, which, scene, nodes, gaps)
            if r > s + _GAIN and (r >= 0.0 or not inside):
                better = True
                break
            step *= 0.5
        if not better:
            break
        px, py, pz, s, which, x, y, z = qx, qy, qz, r, on, rx, ry, rz
    return px, py, pz, s


@kernel
def bin_triangles(
    vertices: Any, triangles: Any, origin: Any, scale: float, columns: int, rows: int
) -> tuple[Any, Any]:
    """Cells of the grid with the triangles above them: `starts` and `items` of a scene."""
    span = np.empty((len(triangles), 4), np.int32)
    starts = np.zeros(columns * rows + 1, np.int64)
    for t in range(len(triangles)):
        a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
        x0 = int((min(a[0], b[0], c[0]) - origin[0]) * scale)
        x1 = int((max(a[0], b[0], c[0]) - origin[0]) * scale)
        y0 = int((min(a[1], b[1], c[1]) - origin[1]) * scale)
        y1 = int((max(a[1], b[1], c[1]) - origin[1]) * scale)
        span[t, 0], span[t, 1] = x0, min(x1, columns - 1)
        span[t, 2], span[t, 3] = y0, min(y1, rows - 1)
        for y in range(span[t, 2], span[t, 3] + 1):
            for x in range(span[t, 0], span[t, 1] + 1):
                starts[y * columns + x + 1] += 1
    for k in range(columns * rows):
        starts[k + 1] += starts[k]
    items, fill = np.empty(starts[-1], np.int32), starts[:-1].copy()
    for t in range(len(triangles)):
        for y in range(span[t, 2], span[t, 3] + 1):
            for x in range(span[t, 0], span[t, 1] + 1):
                items[fill[y * columns + x]] = t
                fill[y * columns + x] += 1
    return starts, items


@kernel
def signed_distances(points: Any, scene: Any, limit: float, out: Any) -> None:
    """Signed distance of each point, negative inside; inf where it is outside beyond the limit.

    points  (n, 3)  float64  in
    scene           tuple    see the module
    limit           float    metres, in
    out     (n,)    float64  out
    """
    nodes, gaps = np.empty(2 * scene[2] + 2, np.int64), np.empty(2 * scene[2] + 2, np.float64)
    for i in range(len(points)):
        out[i] = _signed(points[i, 0], points[i, 1], points[i, 2], limit, -1, scene, nodes, gaps)[0]


@kernel
def push_frame(
    points: Any,
    fixed: Any,
    starts: Any,
    neighbours: Any,
    sweeps: int,
    margin: float,
    farthest: float,
    scene: Any,
    hints: Any,
    out: Any,
    before: Any,
    after: Any,
) -> None:
    """Move the points of one frame out of the body.

    points      (n, 3)  float64  in
    fixed       (n,)    bool     points that stay, in
    starts      (n+1,)  int32    first neighbour of each point, in
    neighbours  (m,)    int32    of all points, in
    sweeps              int      Jacobi sweeps of the displacements
    margin              float    metres above the skin
    farthest            float    metres that a point is moved along skin that is covered
    scene               tuple    see the module
    hints       (n,)    int32    a triangle likely to be near each point, or −1; updated
    out         (n, 3)  float64  out
    before      (n,)    float64  signed distances, inf beyond the margin or fixed; out
    after       (n,)    float64  the same for `out`; out
    """
    n = len(points)
    nodes, gaps = np.empty(2 * scene[2] + 2, np.int64), np.empty(2 * scene[2] + 2, np.float64)
    wanted, length = np.zeros((n, 3)), np.zeros(n)
    any_moved = False
    for i in range(n):
        out[i] = points[i]
        before[i] = after[i] = np.inf
        if fixed[i]:
            continue
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        s, which, _, _, _ = _signed(px, py, pz, margin, hints[i], scene, nodes, gaps)
        before[i] = after[i] = s
        if which >= 0:
            hints[i] = which
        if s >= margin - _GAIN:
            continue
        qx, qy, qz, _ = _move_out(px, py, pz, margin, farthest, which, scene, nodes, gaps)
        wanted[i, 0], wanted[i, 1], wanted[i, 2] = qx - px, qy - py, qz - pz
        length[i] = np.sqrt((wanted[i] * wanted[i]).sum())
        any_moved = any_moved or length[i] > 0.0
    if not any_moved:
        return
    field, other = wanted.copy(), np.zeros((n, 3))
    for _ in range(sweeps):
        for i in range(n):
            x, y, z = 0.0, 0.0, 0.0
            if not fixed[i] and starts[i + 1] > starts[i]:
                for k in range(starts[i], starts[i + 1]):
                    j = neighbours[k]
                    x += field[j, 0]
                    y += field[j, 1]
                    z += field[j, 2]
                share = 1.0 / (starts[i + 1] - starts[i])
                x, y, z = x * share, y * share, z * share
            if length[i] > 0.0:
                w = wanted[i]
                lack = 1.0 - (w[0] * x + w[1] * y + w[2] * z) / length[i] ** 2
                if lack > 0.0:
                    x, y, z = x + lack * w[0], y + lack * w[1], z + lack * w[2]
            other[i, 0], other[i, 1], other[i, 2] = x, y, z
        field, other = other, field
    for i in range(n):
        f = field[i]
        if f[0] == 0.0 and f[1] == 0.0 and f[2] == 0.0:
            continue
        px, py, pz, s = _move_out(
            points[i, 0] + f[0],
            points[i, 1] + f[1],
            points[i, 2] + f[2],
            margin,
            farthest,
            hints[i],
            scene,
            nodes,
            gaps,
        )
        if s < min(before[i], margin - _GAIN):
            continue
        out[i, 0], out[i, 1], out[i, 2], after[i] = px, py, pz, s
