"""Kernels that move cloth out of a body, to the skin that faces as the cloth does.

A pose of the body is passed as one tuple, `scene`, as :mod:`garmentnet.collision.kernels`
describes it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ssdr.kernels.policy import inline, kernel

from .crossing_kernels import after, box_of, edge_meets, meeting_leaf, normal_of, straddles
from .kernels import nearest_facing, spread, winding

# Cosine of the angle to the cloth's normal from which skin faces the way out.
_FACING = 0.4
# Cosine from which a limb that an edge passes through lies before the edge's end.
_BEFORE = 0.3
# Skin that faces the other way is taken if it is so many times nearer: what presses on the cloth
# from outside, as an arm.
_NEARER = 5.0
# Rounds without fewer crossings after which what is left is taken for a part of the pose, such as
# limbs that overlap; more would only move the cloth about.
_PATIENCE = 4


@inline
def _outside(v, points, starts, neighbours, firsts, of_vertex, faces):
    """Mean normal of the cloth around a vertex, of its own triangles and its neighbours'."""
    x, y, z = 0.0, 0.0, 0.0
    for k in range(starts[v] - 1, starts[v + 1]):
        u = v if k < starts[v] else neighbours[k]
        for f in range(firsts[u], firsts[u + 1]):
            a, b, c = faces[of_vertex[f], 0], faces[of_vertex[f], 1], faces[of_vertex[f], 2]
            ax, ay, az = points[a, 0], points[a, 1], points[a, 2]
            ux, uy, uz = points[b, 0] - ax, points[b, 1] - ay, points[b, 2] - az
            vx, vy, vz = points[c, 0] - ax, points[c, 1] - ay, points[c, 2] - az
            x, y, z = x + uy * vz - uz * vy, y + uz * vx - ux * vz, z + ux * vy - uy * vx
    size = np.sqrt(x * x + y * y + z * z)
    return (x / size, y / size, z / size) if size > 0.0 else (0.0, 0.0, 0.0)


@inline
def _want(v, x, y, z, fixed, wanted, length):
    size = np.sqrt(x * x + y * y + z * z)
    if not fixed[v] and size > length[v]:
        wanted[v, 0], wanted[v, 1], wanted[v, 2], length[v] = x, y, z, size


@inline
def _find(points, garment, scene, bounds, work, hot, marks, wanted, length):
    """Number of crossings.  They mark edges and their ends, and lift cloth off corners of the body.

    `beyond` is the other end of an edge that crosses, −1 without one.  Triangles that are not `hot`
    are known to cross nothing.
    """
    cloth, edges, fixed, _, _, _, _, _, _ = garment
    (margin, reach), (crossed, inside, beyond) = bounds, marks
    corners, depth, boxes = scene
    own, meets = work
    found, other, base = 0, len(corners), (1 << depth) - 1
    meets[:], crossed[:], inside[:], beyond[:], length[:] = False, False, False, -1, 0.0
    for i in range(len(cloth)):
        if not hot[i]:
            continue
        for k in range(3):
            for c in range(3):
                own[i, 3 * k + c] = points[cloth[i, k], c]
        box = box_of(own, i)
        node = meeting_leaf(0, box, boxes, base)
        while node >= 0:
            leaf = node - base
            for j in range((other * leaf) >> depth, (other * (leaf + 1)) >> depth):
                if not (straddles(own, i, corners, j) and straddles(corners, j, own, i)):
                    continue
                for k in range(3):
                    p, q, square = edge_meets(own, i, k, corners, j)
                    if square > 0.0:
                        found += 1
                        meets[i] = True
                        a, b = cloth[i, k], cloth[i, (k + 1) % 3]
                        crossed[edges[i, k]] = inside[a] = inside[b] = True
                        beyond[a], beyond[b] = b, a
                    p, q, square = edge_meets(corners, j, k, own, i)
                    if square > 0.0:
                        found += 1
                        meets[i] = True
                        high, low = max(p, q), min(p, q)
                        size = np.sqrt(square)
                        rise = min(high / size, reach) + margin
                        if high > -_NEARER * low:
                            rise = max(low / size, -reach) - margin
                        rise /= size
                        x, y, z = normal_of(own, i)
                        for e in range(3):
                            _want(cloth[i, e], rise * x, rise * y, rise * z, fixed, wanted, length)
            node = meeting_leaf(after(node), box, boxes, base)
    return found


@kernel
def push_outward(
    points: Any, garment: Any, scene: Any, margin: float, reach: float, sweeps: int, rounds: int
) -> int:
    """Move one frame of cloth, in place, until it crosses the body nowhere or nothing is gained.

    It ends as it was after the round that left the fewest crossings.  The frame as it came does not
    count: if crossings only increase, it is moved all the same.

    points   (V, 3)  float64  in and out
    garment          tuple    of these arrays:
        cloth       (S, 3)  int32  triangles that can move
        edges       (S, 3)  int32  numbers of the edges 01, 12, 20 of these triangles
        fixed       (V,)    bool   vertices that stay
        starts      (V+1,)  int32  first neighbour of each vertex
        neighbours  (m,)    int32  of all vertices
        numbers     (m,)    int32  of the edges to these neighbours
        firsts      (V+1,)  int32  first triangle of each vertex
        of_vertex   (3T,)   int32  triangles of all vertices
        faces       (T, 3)  int32  all triangles
    scene            tuple    the body, see the module
    margin           float    metres above the skin
    reach            float    the farthest skin that is looked for, metres
    sweeps           int      edges over which a displacement spreads
    rounds           int      most repetitions

    Returns the number of crossings found in the first round.
    """
    n = len(points)
    cloth, _, fixed, starts, neighbours, numbers, firsts, of_vertex, faces = garment
    work = np.empty((len(cloth), 9)), np.empty(len(cloth), np.bool_)
    hot, meets = np.ones(len(cloth), np.bool_), work[1]
    nodes, gaps = np.empty(2 * scene[1] + 2, np.int64), np.empty(2 * scene[1] + 2)
    # An edge is a neighbour of both of its ends.
    crossed, inside = np.empty(len(numbers) // 2, np.bool_), np.empty(n, np.bool_)
    beyond, queue, ring = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    wanted, length = np.empty((n, 3)), np.empty(n)
    field, other = np.empty((n, 3)), np.empty((n, 3))
    bounds, marks = (margin, reach), (crossed, inside, beyond)
    first, best, waited, kept = 0, -1, 0, np.empty((n, 3))
    for turn in range(rounds + 1):
        found = _find(points, garment, scene, bounds, work, hot, marks, wanted, length)
        if turn == 0:
            first = found
        elif found < best or best < 0:
            best, waited = found, 0
            kept[:] = points
        else:
            waited += 1
        if found == 0 or waited == _PATIENCE or turn == rounds:
            break
        # Vertices inside: ends of edges that cross, and what hangs on them by edges that do not.
        head, tail = 0, 0
        for v in range(n):
            if inside[v]:
                inside[v] = winding(points[v, 0], points[v, 1], points[v, 2], scene) > 0
                if inside[v] and not fixed[v]:
                    queue[tail] = v
                    tail += 1
        while head < tail:
            v = queue[head]
            head += 1
            for k in range(starts[v], starts[v + 1]):
                u = neighbours[k]
                if inside[u] or fixed[u] or crossed[numbers[k]]:
                    continue
                if winding(points[u, 0], points[u, 1], points[u, 2], scene) > 0:
                    inside[u] = True
                    queue[tail] = u
                    tail += 1
        n_inside = tail
        for v in range(n):
            if beyond[v] >= 0 and not (inside[v] or inside[beyond[v]] or fixed[v]):
                queue[tail] = v
                tail += 1
        for at in range(tail):
            v = queue[at]
            px, py, pz = points[v, 0], points[v, 1], points[v, 2]
            gx, gy, gz = _outside(v, points, starts, neighbours, firsts, of_vertex, faces)
            if at >= n_inside:
                # A limb passes through the edge: of its ends the one before the limb is right.
                u = beyond[v]
                x, y, z = points[u, 0] - px, points[u, 1] - py, points[u, 2] - pz
                if x * gx + y * gy + z * gz <= _BEFORE * np.sqrt(x * x + y * y + z * z):
                    continue
            d, x, y, z, nx, ny, nz = nearest_facing(
                px, py, pz, reach * reach, gx, gy, gz, _FACING, scene, nodes, gaps
            )
            limit = d / _NEARER**2
            e, ex, ey, ez, mx, my, mz = nearest_facing(
                px, py, pz, limit, -gx, -gy, -gz, _FACING, scene, nodes, gaps
            )
            if e < limit:
                d, x, y, z, nx, ny, nz = e, ex, ey, ez, mx, my, mz
            if nx != 0.0 or ny != 0.0 or nz != 0.0:
                length[v] = 0.0
                x, y, z = x + margin * nx - px, y + margin * ny - py, z + margin * nz - pz
                _want(v, x, y, z, fixed, wanted, length)
        # Later rounds correct what is left, for which near neighbours are enough.
        width = sweeps if turn == 0 else min(2, sweeps)
        near = queue[: _rings(width, fixed, starts, neighbours, length, ring, queue)]
        spread(width, near, starts, neighbours, wanted, length, field, other)
        for v in near:
            for c in range(3):
                points[v, c] += field[v, c]
        for i in range(len(cloth)):
            a, b, c = cloth[i, 0], cloth[i, 1], cloth[i, 2]
            hot[i] = meets[i] or ring[a] >= 0 or ring[b] >= 0 or ring[c] >= 0
    if best >= 0 and found > best:
        points[:] = kept
    return first


@inline
def _rings(width, fixed, starts, neighbours, length, ring, queue):
    """Number of the vertices within `width` edges of those that move, which are queued."""
    head, tail = 0, 0
    for v in range(len(length)):
        ring[v] = -1
        if length[v] > 0.0:
            ring[v], queue[tail] = 0, v
            tail += 1
    while head < tail:
        v = queue[head]
        head += 1
        if ring[v] < width:
            for k in range(starts[v], starts[v + 1]):
                u = neighbours[k]
                if ring[u] < 0 and not fixed[u]:
                    ring[u], queue[tail] = ring[v] + 1, u
                    tail += 1
    return tail
