"""Signed distances from points to a closed mesh, and points moved out of it.

The sign is that of the winding number, which a ray to +z counts exactly: the sum of the
orientations of the triangles that it crosses.  Rays and distances search the tree of
:mod:`ssdr.kernels.closest`.

A pose of the body is passed as one tuple, `scene`:

corners  (T, 9)                   float64  of the triangles, in the tree's order
depth                             int      levels of the tree
boxes    (2**(depth + 1) - 1, 6)  float64  of its nodes

Numbers are passed and indexed one by one, since views of rows cost more than the arithmetic.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ssdr.kernels.closest import gap_to_box, push_children
from ssdr.kernels.policy import inline, kernel

from .crossing_kernels import normal_of

# Least gain of distance, metres, by which a step counts, and tolerance of the margin.
_GAIN = 1e-6
# Height above a point of the skin, metres, at which it is tested whether another part covers it.
_ABOVE = 1e-5
_STEPS = 24
# Distance within which the skin is searched, metres: if a vertex is farther away, its neighbours
# need no search.
_LOOK = 0.06


@inline
def closest(px, py, pz, corners, i):
    """Squared distance to a triangle and its closest point (Ericson 2005, section 5.1.5)."""
    ax, ay, az = corners[i, 0], corners[i, 1], corners[i, 2]
    ux, uy, uz = corners[i, 3] - ax, corners[i, 4] - ay, corners[i, 5] - az
    vx, vy, vz = corners[i, 6] - ax, corners[i, 7] - ay, corners[i, 8] - az
    wx, wy, wz = px - ax, py - ay, pz - az
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
    x, y, z = s * ux + t * vx, s * uy + t * vy, s * uz + t * vz
    return (wx - x) ** 2 + (wy - y) ** 2 + (wz - z) ** 2, ax + x, ay + y, az + z


@inline
def _crossing(px, py, ax, ay, bx, by):
    """Sign of an edge that crosses the ray from the point to +x: 1 upwards, −1 downwards, else 0.

    It is computed from the lower end to the upper one, so that the two triangles of an edge agree
    to the last bit and no ray slips between them.
    """
    if (ay > py) == (by > py):
        return 0
    if ay < by:
        return 1 if ax + (py - ay) / (by - ay) * (bx - ax) > px else 0
    return -1 if bx + (py - by) / (ay - by) * (ax - bx) > px else 0


@inline
def _side(px, py, pz, corners, i):
    """Sign of a triangle that the ray to +z crosses: 1 out of the body, −1 into it, else 0."""
    ax, ay, az = corners[i, 0], corners[i, 1], corners[i, 2]
    bx, by, bz = corners[i, 3], corners[i, 4], corners[i, 5]
    cx, cy, cz = corners[i, 6], corners[i, 7], corners[i, 8]
    above = ay > py
    if above == (by > py) and above == (cy > py):
        return 0
    if ax <= px and bx <= px and cx <= px:
        return 0
    side = (
        _crossing(px, py, ax, ay, bx, by)
        + _crossing(px, py, bx, by, cx, cy)
        + _crossing(px, py, cx, cy, ax, ay)
    )
    if side == 0:
        return 0
    ux, uy, uz = bx - ax, by - ay, bz - az
    vx, vy, vz = cx - ax, cy - ay, cz - az
    volume = (
        (px - ax) * (uy * vz - uz * vy)
        + (py - ay) * (uz * vx - ux * vz)
        + (pz - az) * (ux * vy - uy * vx)
    )
    # Below the triangle: behind it if it faces up, before it if it faces down.
    return side if volume * side < 0.0 else 0


@inline
def winding(px, py, pz, scene):
    """The winding number of the mesh about a point."""
    corners, depth, boxes = scene
    count, base = len(corners), (1 << depth) - 1
    total, node = 0, 0
    while True:
        if (
            px >= boxes[node, 0]
            and px <= boxes[node, 3]
            and py >= boxes[node, 1]
            and py <= boxes[node, 4]
            and pz <= boxes[node, 5]
        ):
            if node < base:
                node = 2 * node + 1
                continue
            j = node - base
            for t in range((count * j) >> depth, (count * (j + 1)) >> depth):
                total += _side(px, py, pz, corners, t)
        # A right child has an even index: the subtrees that end with it are done.
        while node > 0 and node & 1 == 0:
            node = (node - 1) >> 1
        if node == 0:
            return total
        node += 1


@inline
def _nearest(px, py, pz, limit, hint, free, scene, nodes, gaps):
    """Squared distance, triangle (−1: none nearer than `limit`, squared) and closest point.

    With `free`, points of the skin that another part of the body covers do not count.
    """
    corners, depth, boxes = scene
    count, base = len(corners), (1 << depth) - 1
    best, which, cx, cy, cz = limit, -1, px, py, pz
    if hint >= 0 and not free:
        d, x, y, z = closest(px, py, pz, corners, hint)
        if d < best:
            best, which, cx, cy, cz = d, hint, x, y, z
    nodes[0], gaps[0], top = 0, gap_to_box(px, py, pz, boxes, 0), 1
    while top > 0:
        top -= 1
        if gaps[top] >= best:
            continue
        node = nodes[top]
        if node >= base:
            j = node - base
            for t in range((count * j) >> depth, (count * (j + 1)) >> depth):
                d, x, y, z = closest(px, py, pz, corners, t)
                if d < best:
                    if free and d > 0.0:
                        f = 1.0 + _ABOVE / np.sqrt(d)
                        qx, qy, qz = px + f * (x - px), py + f * (y - py), pz + f * (z - pz)
                        if winding(qx, qy, qz, scene) > 0:
                            continue
                    best, which, cx, cy, cz = d, t, x, y, z
            continue
        left = gap_to_box(px, py, pz, boxes, 2 * node + 1)
        right = gap_to_box(px, py, pz, boxes, 2 * node + 2)
        top = push_children(node, left, right, best, nodes, gaps, top)
    return best, which, cx, cy, cz


@inline
def _signed(px, py, pz, margin, hint, scene, nodes, gaps):
    """Signed distance of a point to the skin, the nearest triangle and the closest point on it.

    The distance is inf if the point is outside and farther away than the margin.
    """
    inside = winding(px, py, pz, scene) > 0
    limit = np.inf if inside else margin * margin
    d, which, x, y, z = _nearest(px, py, pz, limit, hint, False, scene, nodes, gaps)
    if which < 0:
        return np.inf, which, x, y, z
    return (-np.sqrt(d) if inside else np.sqrt(d)), which, x, y, z


@inline
def _unit_normal(corners, i):
    """Unit normal of triangle corners[i]; 0 if the triangle has no area."""
    x, y, z = normal_of(corners, i)
    length = np.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return 0.0, 0.0, 0.0
    return x / length, y / length, z / length


@inline
def _move_out(px, py, pz, margin, farthest, hint, scene, nodes, gaps):
    """Position of a point moved out to the margin, or as far as possible; and its distance."""
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
            ux, uy, uz = _unit_normal(scene[0], which)
            if ux == 0.0 and uy == 0.0 and uz == 0.0:
                break
        # Between two parts of the body that nearly touch, the full margin does not fit.
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
def signed_distances(points: Any, scene: Any, limit: float, out: Any) -> None:
    """Signed distance of each point, negative inside; inf where it is outside beyond the limit.

    points  (n, 3)  float64  in
    scene           tuple    see the module
    limit           float    metres, in
    out     (n,)    float64  out
    """
    nodes, gaps = np.empty(2 * scene[1] + 2, np.int64), np.empty(2 * scene[1] + 2, np.float64)
    for i in range(len(points)):
        out[i] = _signed(points[i, 0], points[i, 1], points[i, 2], limit, -1, scene, nodes, gaps)[0]


@inline
def spread(sweeps, queue, starts, neighbours, wanted, length, field, other):
    """Smooth the wanted displacements over the queued vertices by Jacobi sweeps, into `field`.

    Each vertex gets the mean of its neighbours, and at least what is wanted along that direction;
    vertices that are not queued do not move.
    """
    field[:], other[:] = 0.0, 0.0
    for v in queue:
        if length[v] > 0.0:
            for c in range(3):
                field[v, c] = wanted[v, c]
    for _ in range(sweeps):
        for v in queue:
            x, y, z = 0.0, 0.0, 0.0
            count = starts[v + 1] - starts[v]
            if count > 0:
                for k in range(starts[v], starts[v + 1]):
                    u = neighbours[k]
                    x, y, z = x + field[u, 0], y + field[u, 1], z + field[u, 2]
                share = 1.0 / count
                x, y, z = x * share, y * share, z * share
            if length[v] > 0.0:
                wx, wy, wz = wanted[v, 0], wanted[v, 1], wanted[v, 2]
                lack = 1.0 - (wx * x + wy * y + wz * z) / length[v] ** 2
                if lack > 0.0:
                    x, y, z = x + lack * wx, y + lack * wy, z + lack * wz
            other[v, 0], other[v, 1], other[v, 2] = x, y, z
        for v in queue:
            for c in range(3):
                field[v, c] = other[v, c]


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
    """
    n = len(points)
    nodes, gaps = np.empty(2 * scene[1] + 2, np.int64), np.empty(2 * scene[1] + 2, np.float64)
    wanted, length = np.zeros((n, 3)), np.zeros(n)
    any_moved, look = False, max(_LOOK, margin)
    # Lower bounds of the distance of points that are known to be outside.
    clear, before = np.zeros(n), np.full(n, np.inf)
    for i in range(n):
        for c in range(3):
            out[i, c] = points[i, c]
        if fixed[i]:
            continue
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        s = clear[i]
        if s < margin:
            s, which, _, _, _ = _signed(px, py, pz, look, hints[i], scene, nodes, gaps)
            s = min(s, look)
            if which >= 0:
                hints[i] = which
        clear[i] = s
        if s >= margin - _GAIN:
            for k in range(starts[i], starts[i + 1]):
                j = neighbours[k]
                if j > i:
                    x, y, z = points[j, 0] - px, points[j, 1] - py, points[j, 2] - pz
                    clear[j] = max(clear[j], s - np.sqrt(x * x + y * y + z * z))
            continue
        before[i] = s
        qx, qy, qz, _ = _move_out(px, py, pz, margin, farthest, which, scene, nodes, gaps)
        wanted[i, 0], wanted[i, 1], wanted[i, 2] = qx - px, qy - py, qz - pz
        length[i] = np.sqrt((qx - px) ** 2 + (qy - py) ** 2 + (qz - pz) ** 2)
        any_moved = any_moved or length[i] > 0.0
    if not any_moved:
        return
    field, other = np.empty((n, 3)), np.empty((n, 3))
    spread(sweeps, np.flatnonzero(~fixed), starts, neighbours, wanted, length, field, other)
    for i in range(n):
        fx, fy, fz = field[i, 0], field[i, 1], field[i, 2]
        if fx == 0.0 and fy == 0.0 and fz == 0.0:
            continue
        px, py, pz = points[i, 0] + fx, points[i, 1] + fy, points[i, 2] + fz
        if clear[i] - np.sqrt(fx * fx + fy * fy + fz * fz) < margin:
            hint = hints[i]
            px, py, pz, s = _move_out(px, py, pz, margin, farthest, hint, scene, nodes, gaps)
            if s < min(before[i], margin - _GAIN):
                continue
        out[i, 0], out[i, 1], out[i, 2] = px, py, pz
