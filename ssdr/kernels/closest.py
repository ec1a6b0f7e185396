"""Distance from points to the triangles of a bounding-volume hierarchy.

The tree is a complete binary tree over T triangles.  Node j of a level has the index
``2**level - 1 + j`` and covers the triangles from ``T * j >> level`` up to, but not including,
``T * (j + 1) >> level``, so that neither ranges nor links need to be stored.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .policy import inline, kernel


@inline
def _segment(p, a, b):
    """Squared distance of a point p to the segment from a to b."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    length = ux * ux + uy * uy + uz * uz
    s = 0.0
    if length > 0.0:
        s = min(1.0, max(0.0, (ux * vx + uy * vy + uz * vz) / length))
    vx -= s * ux
    vy -= s * uy
    vz -= s * uz
    return vx * vx + vy * vy + vz * vz


@inline
def _triangle(p, vertices, triangle):
    """Squared distance of a point to a triangle.

    If a triangle is thinner than 1e-7 of its length, this is the distance to its edges.
    """
    a, b, c = vertices[triangle[0]], vertices[triangle[1]], vertices[triangle[2]]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    wx, wy, wz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    uu = ux * ux + uy * uy + uz * uz
    uv = ux * vx + uy * vy + uz * vz
    vv = vx * vx + vy * vy + vz * vz
    wu = wx * ux + wy * uy + wz * uz
    wv = wx * vx + wy * vy + wz * vz
    det = uu * vv - uv * uv
    s = vv * wu - uv * wv
    t = uu * wv - uv * wu
    if det > 1e-14 * uu * vv and s >= 0.0 and t >= 0.0 and s + t <= det:
        s /= det
        t /= det
        x, y, z = wx - s * ux - t * vx, wy - s * uy - t * vy, wz - s * uz - t * vz
        return x * x + y * y + z * z
    return min(_segment(p, a, b), _segment(p, b, c), _segment(p, c, a))


@inline
def gap_to_box(px, py, pz, boxes, i):
    """Squared distance of a point to the axis-aligned box boxes[i]."""
    x = max(0.0, max(boxes[i, 0] - px, px - boxes[i, 3]))
    y = max(0.0, max(boxes[i, 1] - py, py - boxes[i, 4]))
    z = max(0.0, max(boxes[i, 2] - pz, pz - boxes[i, 5]))
    return x * x + y * y + z * z


@inline
def push_children(node, left, right, best, nodes, gaps, top):
    """Push the children of a tree's node that are nearer than `best` onto the stack of a search.

    The nearer one comes last, to be visited first.  `left` and `right` are the squared distances
    to the children's boxes; the new height of the stack is returned.
    """
    if left > right:
        near, far, first, last = right, left, 2 * node + 2, 2 * node + 1
    else:
        near, far, first, last = left, right, 2 * node + 1, 2 * node + 2
    if far < best:
        nodes[top], gaps[top] = last, far
        top += 1
    if near < best:
        nodes[top], gaps[top] = first, near
        top += 1
    return top


def tree_order(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], depth: int
) -> NDArray[np.intp]:
    """Order (T,) of the triangles in which each node of the tree covers nearby ones.

    Leaves are at level `depth`, the root at level 0.
    """
    centres = vertices[faces].mean(axis=1)
    order, count = np.arange(len(faces)), len(faces)
    for level in range(depth):
        for j in range(1 << level):
            start, stop = (count * j) >> level, (count * (j + 1)) >> level
            middle = (count * (2 * j + 1)) >> (level + 1)
            part = centres[order[start:stop]]
            if start < middle < stop:
                axis = int(np.ptp(part, axis=0).argmax())
                order[start:stop] = order[start:stop][
                    np.argpartition(part[:, axis], middle - start)
                ]
    return order


@kernel
def fit_boxes(vertices, triangles, depth, boxes):
    """Compute the bounding boxes of all nodes of the tree, from the leaves to the root.

    vertices   (V, 3)                  float64  positions, in
    triangles  (T, 3)                  int32    vertices of triangles in the tree's order, in
    depth                              int      number of levels below the root
    boxes      (2**(depth + 1) - 1, 6)  float64  lower, then upper corner of each node, out
    """
    count = len(triangles)
    base = (1 << depth) - 1
    for j in range(1 << depth):
        # bounds in registers take a fraction of the time of bounds in an array
        ax, ay, az, bx, by, bz = np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf
        for t in range((count * j) >> depth, (count * (j + 1)) >> depth):
            for k in range(3):
                i = triangles[t, k]
                x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
                ax, ay, az = min(ax, x), min(ay, y), min(az, z)
                bx, by, bz = max(bx, x), max(by, y), max(bz, z)
        n = base + j
        boxes[n, 0], boxes[n, 1], boxes[n, 2] = ax, ay, az
        boxes[n, 3], boxes[n, 4], boxes[n, 5] = bx, by, bz
    for node in range(base - 1, -1, -1):
        for c in range(3):
            boxes[node, c] = min(boxes[2 * node + 1, c], boxes[2 * node + 2, c])
            boxes[node, 3 + c] = max(boxes[2 * node + 1, 3 + c], boxes[2 * node + 2, 3 + c])


@kernel
def farthest(points, vertices, triangles, depth, boxes, hints, lead):
    """Find the point farthest from the triangles; return its squared distance and its index.

    points     (n, 3)                  float64  positions of the points, in
    vertices   (V, 3)                  float64  positions of the triangles' corners, in
    triangles  (T, 3)                  int32    vertices of triangles in the tree's order, in
    depth                              int      number of levels below the root
    boxes      (2**(depth + 1) - 1, 6)  float64  from :func:`fit_boxes`, in
    hints      (n,)                    int64    index of a triangle likely near each point, updated
    lead                               int      index of the point that is searched first

    The search for a point ends as soon as a triangle is found nearer to it than the largest
    distance so far, so that most searches are short if the first point is far from the triangles.
    """
    count = len(triangles)
    stack_node = np.empty(2 * depth + 2, dtype=np.int64)
    stack_gap = np.empty(2 * depth + 2, dtype=np.float64)
    worst, where = -1.0, 0
    base = (1 << depth) - 1
    for turn in range(-1, len(points)):
        i = lead if turn < 0 else turn
        p = points[i]
        best = _triangle(p, vertices, triangles[hints[i]])
        if best <= worst:
            continue
        stack_node[0], stack_gap[0], top = 0, gap_to_box(p[0], p[1], p[2], boxes, 0), 1
        while top > 0 and best > worst:
            top -= 1
            if stack_gap[top] >= best:
                continue
            node = stack_node[top]
            if node >= base:
                j = node - base
                for t in range((count * j) >> depth, (count * (j + 1)) >> depth):
                    gap = _triangle(p, vertices, triangles[t])
                    if gap < best:
                        best = gap
                        hints[i] = t
                continue
            left = gap_to_box(p[0], p[1], p[2], boxes, 2 * node + 1)
            right = gap_to_box(p[0], p[1], p[2], boxes, 2 * node + 2)
            top = push_children(node, left, right, best, stack_node, stack_gap, top)
        if best > worst:
            worst, where = best, i
    return worst, where
