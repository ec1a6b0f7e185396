"""Signed distances from points to a closed mesh, and displacements spread over cloth.

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

from .crossing_kernels import after, normal_of


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
    while node >= 0:
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
        node = after(node)
    return total


@inline
def nearest_facing(px, py, pz, limit, gx, gy, gz, cosine, scene, nodes, gaps):
    """Squared distance to the mesh, its closest point and the normal there.

    Triangles count whose normal has more than the given cosine with (gx, gy, gz).  The distance is
    `limit`, squared, if there is none nearer.
    """
    corners, depth, boxes = scene
    count, base = len(corners), (1 << depth) - 1
    best, cx, cy, cz, fx, fy, fz = limit, px, py, pz, 0.0, 0.0, 0.0
    nodes[0], gaps[0], top = 0, gap_to_box(px, py, pz, boxes, 0), 1
    while top > 0:
        top -= 1
        if gaps[top] >= best:
            continue
        node = nodes[top]
        if node >= base:
            j = node - base
            for t in range((count * j) >> depth, (count * (j + 1)) >> depth):
                nx, ny, nz = normal_of(corners, t)
                size = np.sqrt(nx * nx + ny * ny + nz * nz)
                if nx * gx + ny * gy + nz * gz <= cosine * size:
                    continue
                d, x, y, z = closest(px, py, pz, corners, t)
                if d < best:
                    best, cx, cy, cz = d, x, y, z
                    fx, fy, fz = nx / size, ny / size, nz / size
            continue
        left = gap_to_box(px, py, pz, boxes, 2 * node + 1)
        right = gap_to_box(px, py, pz, boxes, 2 * node + 2)
        top = push_children(node, left, right, best, nodes, gaps, top)
    return best, cx, cy, cz, fx, fy, fz


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
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        inside = winding(px, py, pz, scene) > 0
        most = np.inf if inside else limit * limit
        found = nearest_facing(px, py, pz, most, 0.0, 0.0, 0.0, -1.0, scene, nodes, gaps)
        d = found[0]
        out[i] = -np.sqrt(d) if inside else np.sqrt(d) if d < most else np.inf


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
