"""Contact of the cloth with the body: each vertex with the nearest triangle of the skin.

The tree of the body's triangles is that of :mod:`ssdr.kernels.closest`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ssdr.kernels.closest import push_children

from .policy import ONE, REAL, THREE, TINY, TWO, kernel, ordered_kernel

# Vertices that search the tree together; a multiple of every SIMD width.
CLUSTER = 16
_ZERO, _UNIT, _FAR = REAL(0), REAL(1), REAL(1e9)
# Ratio of squared distances below which the search moves on to a neighbouring triangle.
_GAIN = REAL(0.9999)
# Barycentric coordinate from which a point counts as lying on the far edge.
_EDGE = REAL(0.99999)
# Distance, metres: a point nearer to the skin is pushed along the triangle's normal.
_ON_SKIN = REAL(1e-5)
# Number of triangles that are tried in a substep, beginning with that of the substep before.
_HOPS = 3


@kernel
def skin_points(skin: Any, transforms: Any, out: Any) -> None:
    """Linear blend skinning of points.

    skin        tuple     rest (n, 3) float32, indices (n, K) int32, weights (n, K) float32
    transforms  (J, 12)   float32
    out         (3 n,)    float32
    """
    rest, indices, weights = skin
    blend = np.empty(12, transforms.dtype)
    for i in range(len(rest)):
        blend[:] = 0
        for q in range(indices.shape[1]):
            w, j = weights[i, q], indices[i, q]
            for k in range(12):
                blend[k] += w * transforms[j, k]
        x, y, z = rest[i, 0], rest[i, 1], rest[i, 2]
        for r in range(3):
            out[3 * i + r] = (
                blend[4 * r] * x + blend[4 * r + 1] * y + blend[4 * r + 2] * z + blend[4 * r + 3]
            )


@ordered_kernel
def _closest(px, py, pz, ax, ay, az, ux, uy, uz, vx, vy, vz):
    """Coordinates s, t of the closest point a + s u + t v of a triangle (Ericson 2005, 5.1.5)."""
    wx, wy, wz = px - ax, py - ay, pz - az
    d1, d2 = ux * wx + uy * wy + uz * wz, vx * wx + vy * wy + vz * wz
    uu = ux * ux + uy * uy + uz * uz
    uv = ux * vx + uy * vy + uz * vz
    vv = vx * vx + vy * vy + vz * vz
    d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
    vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
    s, t = _ZERO, _ZERO
    if d1 <= _ZERO and d2 <= _ZERO:
        pass
    elif d3 >= _ZERO and d4 <= d3:
        s = _UNIT
    elif vc <= _ZERO and d1 >= _ZERO and d3 <= _ZERO:
        s = d1 / (d1 - d3)
    elif d6 >= _ZERO and d5 <= d6:
        t = _UNIT
    elif vb <= _ZERO and d2 >= _ZERO and d6 <= _ZERO:
        t = d2 / (d2 - d6)
    elif va <= _ZERO and d4 - d3 >= _ZERO and d5 - d6 >= _ZERO:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        s = _UNIT - t
    else:
        share = _UNIT / (va + vb + vc)
        s, t = vb * share, vc * share
    return s, t


@ordered_kernel
def _distance(px, py, pz, points, triangles, t):
    """Squared distance to a triangle."""
    i, j, k = 3 * triangles[t, 0], 3 * triangles[t, 1], 3 * triangles[t, 2]
    ax, ay, az = points[i], points[i + 1], points[i + 2]
    ux, uy, uz = points[j] - ax, points[j + 1] - ay, points[j + 2] - az
    vx, vy, vz = points[k] - ax, points[k + 1] - ay, points[k + 2] - az
    s, q = _closest(px, py, pz, ax, ay, az, ux, uy, uz, vx, vy, vz)
    dx, dy, dz = px - ax - s * ux - q * vx, py - ay - s * uy - q * vy, pz - az - s * uz - q * vz
    return dx * dx + dy * dy + dz * dz


@ordered_kernel
def _try_triangle(lanes, points, triangles, sides, t):
    """Make a triangle the nearest one of those lanes to whose point it is nearer.

    The closest point is in the triangle or on one of its edges; without a branch, so that all lanes
    do the same.
    """
    i, j, k = 3 * triangles[t, 0], 3 * triangles[t, 1], 3 * triangles[t, 2]
    ax, ay, az = points[i], points[i + 1], points[i + 2]
    ux, uy, uz = points[j] - ax, points[j + 1] - ay, points[j + 2] - az
    vx, vy, vz = points[k] - ax, points[k + 1] - ay, points[k + 2] - az
    ex, ey, ez = vx - ux, vy - uy, vz - uz
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    uu, uv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz
    vv, ee = vx * vx + vy * vy + vz * vz, ex * ex + ey * ey + ez * ez
    nn = nx * nx + ny * ny + nz * nz
    per_u, per_v, per_e = _UNIT / (uu + TINY), _UNIT / (vv + TINY), _UNIT / (ee + TINY)
    per_n, side, index = _UNIT / (nn + TINY), REAL(sides[t]), REAL(t)
    for n in range(CLUSTER):
        wx, wy, wz = lanes[n] - ax, lanes[CLUSTER + n] - ay, lanes[2 * CLUSTER + n] - az
        along_u, along_v = wx * ux + wy * uy + wz * uz, wx * vx + wy * vy + wz * vz
        s = min(max(along_u * per_u, _ZERO), _UNIT)
        x, y, z = wx - s * ux, wy - s * uy, wz - s * uz
        d = x * x + y * y + z * z
        s = min(max(along_v * per_v, _ZERO), _UNIT)
        x, y, z = wx - s * vx, wy - s * vy, wz - s * vz
        d = min(d, x * x + y * y + z * z)
        x, y, z = wx - ux, wy - uy, wz - uz
        s = min(max((x * ex + y * ey + z * ez) * per_e, _ZERO), _UNIT)
        x, y, z = x - s * ex, y - s * ey, z - s * ez
        d = min(d, x * x + y * y + z * z)
        q, r = vv * along_u - uv * along_v, uu * along_v - uv * along_u
        above = wx * nx + wy * ny + wz * nz
        inside = min(min(q, r), nn - q - r) > _ZERO
        d = above * above * per_n if inside else d
        d = d if side * lanes[3 * CLUSTER + n] >= _ZERO else _FAR
        best = lanes[4 * CLUSTER + n]
        lanes[5 * CLUSTER + n] = index if d < best else lanes[5 * CLUSTER + n]
        lanes[4 * CLUSTER + n] = min(d, best)


@ordered_kernel
def _gap(box, boxes, i):
    """Squared distance between two boxes."""
    a = max(_ZERO, max(boxes[i, 0] - box[3], box[0] - boxes[i, 3]))
    b = max(_ZERO, max(boxes[i, 1] - box[4], box[1] - boxes[i, 4]))
    c = max(_ZERO, max(boxes[i, 2] - box[5], box[2] - boxes[i, 5]))
    return a * a + b * b + c * c


@ordered_kernel
def _search(lanes, box, farthest, tree, nodes, gaps):
    """Find the nearest triangles of the points of a cluster, which lies in a box.

    `farthest` is the largest squared distance at which a triangle is still of use to one of them.
    """
    points, triangles, sides, depth, boxes = tree
    count, base = len(triangles), (1 << depth) - 1
    nodes[0], gaps[0], top = 0, _gap(box, boxes, 0), 1
    while top > 0:
        top -= 1
        if gaps[top] >= farthest:
            continue
        node = nodes[top]
        if node >= base:
            j = node - base
            for t in range((count * j) >> depth, (count * (j + 1)) >> depth):
                _try_triangle(lanes, points, triangles, sides, t)
            farthest = lanes[4 * CLUSTER]
            for n in range(4 * CLUSTER + 1, 5 * CLUSTER):
                farthest = max(farthest, lanes[n])
            continue
        left, right = _gap(box, boxes, 2 * node + 1), _gap(box, boxes, 2 * node + 2)
        top = push_children(node, left, right, farthest, nodes, gaps, top)


@ordered_kernel
def find_contacts(
    x: Any, clusters: Any, own: Any, reach: Any, tree: Any, nearest: Any, close: Any
) -> int:
    """Find the nearest triangle of every free vertex; return the number of vertices near the skin.

    The vertices of a cluster search the tree together.

    x         (3 V,)         float32  positions of the cloth
    clusters  (C, CLUSTER)   int64    vertices near each other; the first one again in place of
                                      those that are missing
    own       (V,)           int8     1 on a left sleeve or leg, -1 on a right one, 0 elsewhere
    reach                    float32  distance from the skin that is searched, metres
    tree                     tuple    of the skin: points (3 n,) float32, triangles (T, 3) int32,
                                      sides (T,) int8 like `own`, depth, boxes
    nearest   (V,)           int32    triangle of each vertex, updated; -1: none within reach
    close     (V,)           uint64   vertices within reach, as many as are returned; out
    """
    points, triangles, sides, depth, _ = tree
    size, limit, count = 2 * depth + 4, reach * reach, 0
    nodes, gaps = np.empty(size, np.int64), np.empty(size, x.dtype)
    # Rows: position, side, squared distance to the nearest triangle, its index.
    lanes, box = np.empty(6 * CLUSTER, x.dtype), np.empty(6, x.dtype)
    for cluster in clusters:
        box[:3], box[3:], farthest = _FAR, -_FAR, _ZERO
        for n in range(CLUSTER):
            i = cluster[n]
            for k in range(3):
                lanes[k * CLUSTER + n] = x[3 * i + k]
                box[k], box[3 + k] = min(box[k], x[3 * i + k]), max(box[3 + k], x[3 * i + k])
            # The triangle of the search before is likely to be the nearest still.
            best, which, hint = limit, -1, nearest[i]
            if hint >= 0 and sides[hint] * own[i] >= 0:
                d = _distance(x[3 * i], x[3 * i + 1], x[3 * i + 2], points, triangles, hint)
                if d < limit:
                    best, which = d, hint
            lanes[3 * CLUSTER + n] = REAL(own[i])
            lanes[4 * CLUSTER + n], lanes[5 * CLUSTER + n] = best, REAL(which)
            farthest = max(farthest, best)
        _search(lanes, box, farthest, tree, nodes, gaps)
        for n in range(CLUSTER):
            i = cluster[n]
            nearest[i] = np.int32(lanes[5 * CLUSTER + n])
            if nearest[i] >= 0 and (n == 0 or i != cluster[0]):
                close[count] = i
                count += 1
    return count


@kernel
def push_out(
    x: Any,
    previous: Any,
    velocity: Any,
    close: Any,
    n_close: int,
    nearest: Any,
    skin: Any,
    limits: Any,
    rate: Any,
) -> None:
    """Push vertices out to a distance from the moving skin, with friction; set their velocities.

    The constraint is C = n·(x − c) − distance ≥ 0, with the closest point c of the skin and the
    outward direction n from it.  Coulomb friction reduces the tangential displacement relative to
    the skin by at most `friction` times the push (Macklin et al., "Unified Particle Physics for
    Real-Time Applications", 2014, section 6.1).

    The skin moves linearly from its positions (3 n,) at the start of the block of substeps to those
    at the end.  The closest triangle is searched from that of the substep before, over its edges.

    x, previous, velocity  (3 V,)  float32  positions, those before the substep, velocities
    close                  (V,)    uint64   vertices near the skin, the first `n_close`
    nearest                (V,)    int32    triangle of each vertex; updated
    skin                           tuple    3 times the corners of the triangles (T, 3) uint64;
                                            triangle beyond each edge (T, 3), -1: none; positions
                                            at the start and the end of the block; fraction of the
                                            block at the end of this substep; share of the block
                                            that a substep is
    limits                         tuple    distance in metres; coefficient of friction; longest
                                            push in metres: a vertex that a limb has passed over
                                            comes out gently
    rate                           float32  1 / h
    """
    corners, beside, start, end, fraction, share = skin
    distance, friction, most = limits
    for n in range(n_close):
        o = THREE * close[n]
        px, py, pz = x[o], x[o + ONE], x[o + TWO]
        t = at = nearest[close[n]]
        best, s, r = _FAR, _ZERO, _ZERO
        cx, cy, cz, nx, ny, nz = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
        for _ in range(_HOPS):
            i, j, k = corners[at, 0], corners[at, 1], corners[at, 2]
            ax = start[i] + fraction * (end[i] - start[i])
            ay = start[i + ONE] + fraction * (end[i + ONE] - start[i + ONE])
            az = start[i + TWO] + fraction * (end[i + TWO] - start[i + TWO])
            ux = start[j] + fraction * (end[j] - start[j]) - ax
            uy = start[j + ONE] + fraction * (end[j + ONE] - start[j + ONE]) - ay
            uz = start[j + TWO] + fraction * (end[j + TWO] - start[j + TWO]) - az
            vx = start[k] + fraction * (end[k] - start[k]) - ax
            vy = start[k + ONE] + fraction * (end[k + ONE] - start[k + ONE]) - ay
            vz = start[k + TWO] + fraction * (end[k + TWO] - start[k + TWO]) - az
            a, b = _closest(px, py, pz, ax, ay, az, ux, uy, uz, vx, vy, vz)
            dx, dy, dz = (
                px - ax - a * ux - b * vx,
                py - ay - a * uy - b * vy,
                pz - az - a * uz - b * vz,
            )
            square = dx * dx + dy * dy + dz * dz
            if square >= best * _GAIN:
                break
            best, t, s, r = square, at, a, b
            cx, cy, cz = dx, dy, dz
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            if b <= _ZERO:
                at = beside[t, 0]
            elif a <= _ZERO:
                at = beside[t, 2]
            elif a + b >= _EDGE:
                at = beside[t, 1]
            else:
                break
            if at < 0:
                break
        nearest[close[n]] = t
        gap = math.sqrt(best)
        outside = cx * nx + cy * ny + cz * nz >= _ZERO
        if outside and gap >= distance:
            velocity[o] = (px - previous[o]) * rate
            velocity[o + ONE] = (py - previous[o + ONE]) * rate
            velocity[o + TWO] = (pz - previous[o + TWO]) * rate
            continue
        if gap > _ON_SKIN:
            scale = _UNIT / gap if outside else -_UNIT / gap
            nx, ny, nz = cx * scale, cy * scale, cz * scale
        else:
            scale = _UNIT / math.sqrt(nx * nx + ny * ny + nz * nz + TINY)
            nx, ny, nz = nx * scale, ny * scale, nz * scale
        push = min(distance - gap if outside else distance + gap, most)
        px, py, pz = px + push * nx, py + push * ny, pz + push * nz
        # Displacement relative to the skin at the closest point, and its tangential part.
        i, j, k = corners[t, 0], corners[t, 1], corners[t, 2]
        q = _UNIT - s - r
        mx = q * (end[i] - start[i]) + s * (end[j] - start[j]) + r * (end[k] - start[k])
        i, j, k = i + ONE, j + ONE, k + ONE
        my = q * (end[i] - start[i]) + s * (end[j] - start[j]) + r * (end[k] - start[k])
        i, j, k = i + ONE, j + ONE, k + ONE
        mz = q * (end[i] - start[i]) + s * (end[j] - start[j]) + r * (end[k] - start[k])
        dx = px - previous[o] - share * mx
        dy = py - previous[o + ONE] - share * my
        dz = pz - previous[o + TWO] - share * mz
        along = dx * nx + dy * ny + dz * nz
        tx, ty, tz = dx - along * nx, dy - along * ny, dz - along * nz
        slide = math.sqrt(tx * tx + ty * ty + tz * tz) + TINY
        held = min(_UNIT, friction * push / slide)
        px, py, pz = px - held * tx, py - held * ty, pz - held * tz
        x[o], x[o + ONE], x[o + TWO] = px, py, pz
        # A vertex that was pushed leaves the skin no faster than the skin moves: no bounce.
        leaving = max(_ZERO, along)
        velocity[o] = (px - previous[o] - leaving * nx) * rate
        velocity[o + ONE] = (py - previous[o + ONE] - leaving * ny) * rate
        velocity[o + TWO] = (pz - previous[o + TWO] - leaving * nz) * rate
