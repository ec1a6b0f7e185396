"""Naive twins: the same formulas in plain loops, written from the definitions.

Slow on purpose and free of the package's own code, so that the two can only
agree by both being right.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np


def skin(rest, indices, weights, transforms):
    """v_i^t = sum_k w_ik M_{j_ik}^t (p_i, 1), in float64 loops."""
    frames = np.zeros((len(transforms), len(rest), 3))
    for t in range(len(transforms)):
        for i in range(len(rest)):
            p = np.append(np.asarray(rest[i], dtype=np.float64), 1.0)
            for k in range(indices.shape[1]):
                m = np.asarray(transforms[t][indices[i, k]], dtype=np.float64)
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


def sted(reference, other, faces):
    """Both parts of the spatio-temporal edge difference, edge by edge (see ssdr.metrics)."""
    edges = sorted(
        {(min(i, j), max(i, j)) for a, b, c in faces for i, j in ((a, b), (b, c), (c, a)) if i != j}
    )
    n_frames, n_vertices = reference.shape[:2]
    steps = [
        math.dist(reference[t, i], reference[t + 1, i])
        for t in range(n_frames - 1)
        for i in range(n_vertices)
    ]

    def relative(a, b):
        return 0.0 if a == 0 else abs(a - b) / a

    spatial = []
    for i in range(n_vertices):
        mine = [e for e in edges if i in e]
        for t in range(n_frames if mine else 0):
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
                math.sqrt((math.dist(x[t, i], x[t + 1, i]) * len(steps) / sum(steps)) ** 2 + 1)
                for x in (reference, other)
            ]
            lengths.append(pair[0])
            differences.append(relative(*pair))
        for t in range(n_frames - 1):
            inside = slice(max(0, t - 2), t + 3)
            temporal.append(weighted_deviation(differences[inside], lengths[inside]))
    mean = [sum(part) / len(part) if part else 0.0 for part in (spatial, temporal)]
    return mean[0], mean[1]


def squared_error(frames, rest, indices, weights, transforms):
    """Per-vertex sum over frames of the squared distance to the skinned position."""
    gap = np.asarray(frames, dtype=np.float64) - skin(rest, indices, weights, transforms)
    return (gap**2).sum(axis=(0, 2))


def bone_images(rest, transforms):
    """Where each bone alone puts each vertex, (V, F*3, B)."""
    n_frames, n_bones = transforms.shape[:2]
    images = np.zeros((len(rest), n_frames, 3, n_bones))
    for i in range(len(rest)):
        p = np.append(rest[i], 1.0)
        for t in range(n_frames):
            for j in range(n_bones):
                images[i, t, :, j] = transforms[t, j] @ p
    return images.reshape(len(rest), -1, n_bones)


def best_convex(matrix, target, influences):
    """Minimum of |matrix w - target|^2 over the simplex with at most so many weights above 0.

    Every support is tried by its equality-constrained least squares; the optimum
    is among those whose weights are not negative.
    """
    n = matrix.shape[1]
    best, best_w = math.inf, None
    for size in range(1, min(influences, n) + 1):
        for support in combinations(range(n), size):
            a = matrix[:, support]
            edges = a[:, 1:] - a[:, :1]
            tail = np.linalg.lstsq(edges, target - a[:, 0], rcond=None)[0]
            w = np.concatenate([[1 - tail.sum()], tail])
            if w.min() < 0:
                continue
            value = float(((a @ w - target) ** 2).sum())
            if value < best:
                best, best_w = value, np.zeros(n)
                best_w[list(support)] = w
    return best, best_w


def rest_position(frames, indices, weights, transforms):
    """Rest positions by one dense least-squares problem a vertex."""
    out = np.zeros((frames.shape[1], 3))
    for i in range(len(out)):
        rows, right = [], []
        for t in range(len(frames)):
            blended = sum(w * transforms[t, j] for j, w in zip(indices[i], weights[i], strict=True))
            rows.append(blended[:, :3])
            right.append(frames[t, i] - blended[:, 3])
        out[i] = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
    return out


def dirichlet(faces, indices, weights, n_bones):
    """Sum over the mesh's edges of the squared jump of all weights."""
    dense = np.zeros((len(indices), n_bones))
    for i in range(len(indices)):
        for j, w in zip(indices[i], weights[i], strict=True):
            dense[i, j] += w
    edges = {(min(i, j), max(i, j)) for a, b, c in faces for i, j in ((a, b), (b, c), (c, a))}
    return sum(float(((dense[i] - dense[j]) ** 2).sum()) for i, j in edges if i != j)


def weld(vertices, distance):
    """Groups by brute force: connected where every frame is within the distance."""
    n = vertices.shape[1]
    group = list(range(n))
    for i, j in combinations(range(n), 2):
        gap = np.sqrt(((vertices[:, i] - vertices[:, j]) ** 2).sum(axis=1)).max()
        if gap <= distance:
            old, new = max(group[i], group[j]), min(group[i], group[j])
            group = [new if g == old else g for g in group]
    return group


def depth(points, faces, height, width):
    """Nearness at each pixel's centre from the plane through the triangle, pixel by pixel."""
    out = np.full((height, width), -np.inf)
    for face in faces:
        corners = points[face]
        system = np.column_stack([corners[:, :2], np.ones(3)])
        if abs(np.linalg.det(system)) < 1e-12:
            continue
        plane = np.linalg.solve(system, corners[:, 2])
        for row in range(height):
            for column in range(width):
                x, y = column + 0.5, row + 0.5
                sides = []
                for k in range(3):
                    (x0, y0), (x1, y1) = corners[k, :2], corners[(k + 1) % 3, :2]
                    sides.append((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0))
                if all(s >= 0 for s in sides) or all(s <= 0 for s in sides):
                    out[row, column] = max(out[row, column], plane @ [x, y, 1.0])
    return out


def umeyama(source: np.ndarray, target: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Umeyama 1991, equations 34 to 43, with weights."""
    w = w / w.sum()
    a, b = w @ source, w @ target
    covariance = sum(u * np.outer(t - b, s - a) for u, s, t in zip(w, source, target, strict=True))
    u, d, vt = np.linalg.svd(covariance)
    sign = np.array([1, 1, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    r = u @ np.diag(sign) @ vt
    size = (d * sign).sum() / (w * ((source - a) ** 2).sum(axis=1)).sum()
    return np.concatenate([size * r, (b - size * r @ a)[:, None]], axis=1)


def affine(rest, indices, weights, frame, bones, importance) -> np.ndarray:
    """All bones of one frame by a general least-squares solver on the full design matrix."""
    design = np.zeros((len(rest), 4 * bones))
    for i, p in enumerate(rest):
        for j, w in zip(indices[i], weights[i], strict=True):
            design[i, 4 * j : 4 * j + 4] += w * np.append(p, 1.0)
    root = np.sqrt(importance)[:, None]
    found, *_ = np.linalg.lstsq(root * design, root * frame, rcond=None)
    return found.reshape(bones, 4, 3).transpose(0, 2, 1)


def corner_normals(points, faces, groups=None):
    """Normals (T, 3, 3) at corners: triangles' normals times angles, summed over equal groups.

    The groups (T, 3) are the vertices by default.
    """
    groups = faces if groups is None else groups
    sums = {}
    for face, group in zip(faces, groups, strict=True):
        p = points[face].astype(np.float64)
        normal = np.cross(p[1] - p[0], p[2] - p[0])
        size = np.linalg.norm(normal)
        if size == 0:
            continue
        for c in range(3):
            u, v = p[(c + 1) % 3] - p[c], p[(c + 2) % 3] - p[c]
            angle = math.acos(np.clip(u @ v / np.linalg.norm(u) / np.linalg.norm(v), -1, 1))
            key = int(group[c])
            sums[key] = sums.get(key, 0) + angle * normal / size
    out = np.zeros((len(faces), 3, 3))
    for k, group in enumerate(groups):
        for c in range(3):
            total = sums.get(int(group[c]), np.zeros(3))
            size = np.linalg.norm(total)
            out[k, c] = total / size if size > 1e-12 else 0
    return out


def angles(a, b):
    """Angles in degrees between vectors, along the last axis."""
    across = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.degrees(np.arctan2(across, (a * b).sum(axis=-1)))
