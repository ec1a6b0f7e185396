"""Naive twins: the same formulas in plain loops, written from the definitions.

Slow on purpose and free of the package's own code, so that the two can only
agree by both being right.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np


def skin(rest, joints, weights, transforms):
    """v_i^t = sum_k w_ik M_{j_ik}^t (p_i, 1), in float64 loops."""
    frames = np.zeros((len(transforms), len(rest), 3))
    for t in range(len(transforms)):
        for i in range(len(rest)):
            p = np.append(np.asarray(rest[i], dtype=np.float64), 1.0)
            for k in range(joints.shape[1]):
                m = np.asarray(transforms[t][joints[i, k]], dtype=np.float64)
                frames[t, i] += float(weights[i, k]) * (m @ p)
    return frames


def uniform_laplacian(faces, n_vertices):
    """Dense degree matrix minus adjacency matrix."""
    adjacency = np.zeros((n_vertices, n_vertices))
    for a, b, c in faces:
        for i, j in ((a, b), (b, c), (c, a)):
            if i != j:
                adjacency[i, j] = adjacency[j, i] = 1.0
    return np.diag(adjacency.sum(axis=1)) - adjacency


def cotangent_laplacian(vertices, faces):
    """Dense cotangent Laplacian from the angles themselves (no degenerate triangles)."""
    matrix = np.zeros((len(vertices), len(vertices)))
    for face in faces:
        for corner in range(3):
            k, i, j = (face[(corner + s) % 3] for s in range(3))
            u, v = vertices[i] - vertices[k], vertices[j] - vertices[k]
            angle = math.acos(np.clip(u @ v / np.linalg.norm(u) / np.linalg.norm(v), -1, 1))
            weight = 0.5 / math.tan(angle)
            matrix[i, j] -= weight
            matrix[j, i] -= weight
            matrix[i, i] += weight
            matrix[j, j] += weight
    return matrix


def triangle_area(a, b, c):
    """Heron's formula."""
    x, y, z = math.dist(a, b), math.dist(b, c), math.dist(c, a)
    s = (x + y + z) / 2
    return math.sqrt(max(0.0, s * (s - x) * (s - y) * (s - z)))


def barycentric_mass(vertices, faces):
    """A third of the area of each triangle to each of its corners."""
    mass = np.zeros(len(vertices))
    for face in faces:
        for i in face:
            mass[i] += triangle_area(*(vertices[j] for j in face)) / 3
    return mass


def voronoi_mass(vertices, faces):
    """Mixed Voronoi areas from angles (Meyer et al. 2003, figure 4)."""
    mass = np.zeros(len(vertices))
    for face in faces:
        p = [vertices[i] for i in face]
        area = triangle_area(*p)
        angle = []
        for k in range(3):
            u, v = p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]
            angle.append(math.acos(u @ v / np.linalg.norm(u) / np.linalg.norm(v)))
        for k in range(3):
            if max(angle) > math.pi / 2:
                mass[face[k]] += area / 2 if angle[k] > math.pi / 2 else area / 4
                continue
            for other, opposite in (((k + 1) % 3, (k + 2) % 3), ((k + 2) % 3, (k + 1) % 3)):
                side = math.dist(p[k], p[other])
                mass[face[k]] += side**2 / math.tan(angle[opposite]) / 8
    return mass


def point_triangle_distance(point, a, b, c):
    """Distance by projection on the plane, else on the nearest of the three segments."""
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal)
    if size > 0:
        normal = normal / size
        foot = point - ((point - a) @ normal) * normal
        inside = all(np.cross(q - p, foot - p) @ normal >= 0 for p, q in ((a, b), (b, c), (c, a)))
        if inside:
            return abs((point - a) @ normal)
    best = math.inf
    for p, q in ((a, b), (b, c), (c, a)):
        square = (q - p) @ (q - p)
        s = 0.0 if square == 0 else np.clip((point - p) @ (q - p) / square, 0, 1)
        best = min(best, float(np.linalg.norm(point - (p + s * (q - p)))))
    return best


def vertex_hausdorff(a, b):
    """Symmetric Hausdorff distance of two point sets."""
    table = np.linalg.norm(a[:, None] - b[None], axis=2)
    return max(table.min(axis=1).max(), table.min(axis=0).max())


def surface_hausdorff(a, faces_a, b, faces_b):
    """Largest distance from a vertex of one mesh to the surface of the other, both ways."""
    worst = 0.0
    for points, own, others, faces in ((a, faces_a, b, faces_b), (b, faces_b, a, faces_a)):
        for i in {int(i) for face in own for i in face}:
            near = min(
                point_triangle_distance(points[i], *(others[j] for j in face)) for face in faces
            )
            worst = max(worst, near)
    return worst


def weighted_deviation(values, weights):
    """Standard deviation with weights, two passes."""
    total = sum(weights)
    if total == 0:
        return 0.0
    mean = sum(v * w for v, w in zip(values, weights, strict=True)) / total
    square = sum(w * (v - mean) ** 2 for v, w in zip(values, weights, strict=True)) / total
    return math.sqrt(square)


def sted(reference, other, faces, *, neighbourhood, window, dt, normaliser, signed=False):
    """Both parts of the spatio-temporal edge difference, edge by edge (see ssdr.metrics)."""
    edges = sorted(
        {(min(i, j), max(i, j)) for a, b, c in faces for i, j in ((a, b), (b, c), (c, a)) if i != j}
    )
    n_frames, n_vertices = reference.shape[:2]
    near = {i: [] for i in range(n_vertices)}
    for i, j in edges:
        near[i].append(j)
        near[j].append(i)

    def relative(a, b):
        if a == 0:
            return 0.0
        return (a - b) / a if signed else abs(a - b) / a

    spatial = []
    for start in range(n_vertices):
        if not near[start]:
            continue
        hops, queue = {start: 0}, deque([start])
        while queue:
            i = queue.popleft()
            for j in near[i]:
                if j not in hops:
                    hops[j] = hops[i] + 1
                    queue.append(j)
        mine = [
            e for e in edges if min(hops.get(e[0], 10**9), hops.get(e[1], 10**9)) < neighbourhood
        ]
        for t in range(n_frames):
            lengths = [math.dist(reference[t, i], reference[t, j]) for i, j in mine]
            theirs = [math.dist(other[t, i], other[t, j]) for i, j in mine]
            spatial.append(
                weighted_deviation(
                    [relative(a, b) for a, b in zip(lengths, theirs, strict=True)], lengths
                )
            )
    temporal = []
    for i in range(n_vertices):
        lengths, differences = [], []
        for t in range(n_frames - 1):
            pair = [
                math.sqrt(math.dist(x[t, i], x[t + 1, i]) ** 2 / normaliser**2 + dt**2)
                for x in (reference, other)
            ]
            lengths.append(pair[0])
            differences.append(relative(*pair))
        for t in range(n_frames - 1):
            inside = slice(max(0, t - window // 2), t + window // 2 + 1)
            temporal.append(weighted_deviation(differences[inside], lengths[inside]))
    mean = [sum(part) / len(part) if part else 0.0 for part in (spatial, temporal)]
    return mean[0], mean[1]
