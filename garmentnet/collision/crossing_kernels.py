"""Triangles of two meshes that cross, by a tree of boxes of :mod:`ssdr.kernels.closest`."""

from __future__ import annotations

from typing import Any

import numpy as np

from ssdr.kernels.policy import inline, kernel


@inline
def normal_of(corners, i):
    """Normal of triangle corners[i]; its length is twice the area."""
    ax, ay, az = corners[i, 0], corners[i, 1], corners[i, 2]
    ux, uy, uz = corners[i, 3] - ax, corners[i, 4] - ay, corners[i, 5] - az
    vx, vy, vz = corners[i, 6] - ax, corners[i, 7] - ay, corners[i, 8] - az
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@inline
def straddles(a, i, b, j):
    """Whether corners of triangle a[i] lie on both sides of the plane of triangle b[j]."""
    ox, oy, oz = b[j, 0], b[j, 1], b[j, 2]
    nx, ny, nz = normal_of(b, j)
    first = nx * (a[i, 0] - ox) + ny * (a[i, 1] - oy) + nz * (a[i, 2] - oz) > 0.0
    second = nx * (a[i, 3] - ox) + ny * (a[i, 4] - oy) + nz * (a[i, 5] - oz) > 0.0
    third = nx * (a[i, 6] - ox) + ny * (a[i, 7] - oy) + nz * (a[i, 8] - oz) > 0.0
    return first != second or second != third


@inline
def edge_meets(a, i, k, b, j):
    """Heights of the ends of edge k of triangle a[i] above the plane of triangle b[j], times the
    length of its normal, and the square of this length; 0 if they do not cross.
    """
    k, m = 3 * k, 3 * ((k + 1) % 3)
    ox, oy, oz = b[j, 0], b[j, 1], b[j, 2]
    ux, uy, uz = b[j, 3] - ox, b[j, 4] - oy, b[j, 5] - oz
    vx, vy, vz = b[j, 6] - ox, b[j, 7] - oy, b[j, 8] - oz
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    px, py, pz = a[i, k] - ox, a[i, k + 1] - oy, a[i, k + 2] - oz
    qx, qy, qz = a[i, m] - ox, a[i, m + 1] - oy, a[i, m + 2] - oz
    p, q = nx * px + ny * py + nz * pz, nx * qx + ny * qy + nz * qz
    if (p > 0.0) == (q > 0.0):
        return p, q, 0.0
    s = p / (p - q)
    x, y, z = px + s * (qx - px), py + s * (qy - py), pz + s * (qz - pz)
    square = nx * nx + ny * ny + nz * nz
    # Barycentric coordinates of the point in the plane, times the square.
    second = nx * (y * vz - z * vy) + ny * (z * vx - x * vz) + nz * (x * vy - y * vx)
    third = nx * (uy * z - uz * y) + ny * (uz * x - ux * z) + nz * (ux * y - uy * x)
    if second < 0.0 or third < 0.0 or second + third > square:
        return p, q, 0.0
    return p, q, square


@inline
def _depth(a, i, k, b, j):
    """Distance from the plane of the nearer end of an edge that crosses; negative: none does."""
    p, q, square = edge_meets(a, i, k, b, j)
    return min(abs(p), abs(q)) / np.sqrt(square) if square > 0.0 else -1.0


@inline
def box_of(a, i):
    """Lower and upper corner of the box around triangle a[i]."""
    return (
        min(a[i, 0], a[i, 3], a[i, 6]),
        min(a[i, 1], a[i, 4], a[i, 7]),
        min(a[i, 2], a[i, 5], a[i, 8]),
        max(a[i, 0], a[i, 3], a[i, 6]),
        max(a[i, 1], a[i, 4], a[i, 7]),
        max(a[i, 2], a[i, 5], a[i, 8]),
    )


@inline
def beside(box, b, j):
    """Whether a box and box b[j] are apart along an axis."""
    return (
        box[0] > b[j, 3]
        or box[3] < b[j, 0]
        or box[1] > b[j, 4]
        or box[4] < b[j, 1]
        or box[2] > b[j, 5]
        or box[5] < b[j, 2]
    )


@inline
def after(node):
    """The node that follows a subtree in depth-first order; −1 at the end of the tree."""
    # A right child has an even index: the subtrees that end with it are done.
    while node > 0 and node & 1 == 0:
        node = (node - 1) >> 1
    return node + 1 if node > 0 else -1


@inline
def meeting_leaf(node, box, boxes, base):
    """Index of the first leaf, at `node` or after it, whose box meets `box`; −1 if none does.

    The order is depth-first.

    `base` is the index of the first leaf.
    """
    while node >= 0:
        if beside(box, boxes, node):
            node = after(node)
        elif node < base:
            node = 2 * node + 1
        else:
            break
    return node


@kernel
def count_crossings(cloth: Any, corners: Any, depth: int, boxes: Any) -> tuple[int, float]:
    """Number of pairs of triangles that cross, and the depth of the deepest.

    cloth    (S, 9)                   float64  corners of triangles, in
    corners  (T, 9)                   float64  of the body's triangles, in the tree's order, in
    depth                             int      levels of the tree of :mod:`ssdr.kernels.closest`
    boxes    (2**(depth + 1) - 1, 6)  float64  of its nodes, in
    """
    count, base = len(corners), (1 << depth) - 1
    pairs, deepest = 0, 0.0
    for i in range(len(cloth)):
        box = box_of(cloth, i)
        node = meeting_leaf(0, box, boxes, base)
        while node >= 0:
            leaf = node - base
            for j in range((count * leaf) >> depth, (count * (leaf + 1)) >> depth):
                if not (straddles(cloth, i, corners, j) and straddles(corners, j, cloth, i)):
                    continue
                most = -1.0
                for k in range(3):
                    most = max(most, _depth(cloth, i, k, corners, j))
                    most = max(most, _depth(corners, j, k, cloth, i))
                if most >= 0.0:
                    pairs += 1
                    deepest = max(deepest, most)
            node = meeting_leaf(after(node), box, boxes, base)
    return pairs, deepest
