"""Normals of surfaces, of models as engines draw them, and the angles between them, by loops."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

import ssdr

Float = NDArray[np.float64]


def surface_normals(points: Float, faces: NDArray[np.int32], hard: Float | None = None) -> Float:
    """Normals (T, 3, 3) by the angles of the triangles; corners with equal `hard` share one."""
    sums: dict[tuple[float, ...], Float] = {}
    keys = []
    for t, face in enumerate(faces):
        p = [points[v].astype(np.float64) for v in face]
        normal = np.cross(p[1] - p[0], p[2] - p[0])
        normal /= np.linalg.norm(normal)
        for c in range(3):
            a, b = p[(c + 1) % 3] - p[c], p[(c + 2) % 3] - p[c]
            angle = np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))
            key = (int(face[c]), *(() if hard is None else hard[t, c].tolist()))
            sums[key] = sums.get(key, 0.0) + angle * normal
            keys.append(key)
    return np.array([sums[k] / np.linalg.norm(sums[k]) for k in keys]).reshape(-1, 3, 3)


def hard_edges(model: ssdr.Skinning | ssdr.MeshSequence) -> Float | None:
    return None if model.surface is None else model.surface.normals


def drawn_normals(model: ssdr.Skinning, frame: int) -> Float:
    """Normals (T, 3, 3) of the rest pose, turned by Σ w R."""
    rest = hard_edges(model)
    rest = surface_normals(model.rest, model.faces) if rest is None else rest
    out = np.empty((len(model.faces), 3, 3))
    for t, c in np.ndindex(len(model.faces), 3):
        v = model.faces[t, c]
        blend = sum(
            w * model.transforms[frame, b, :, :3].astype(np.float64)
            for b, w in zip(model.indices[v], model.weights[v], strict=True)
        )
        turned = blend @ rest[t, c]
        out[t, c] = turned / np.linalg.norm(turned)
    return out


def angles(
    reference: ssdr.MeshSequence, model: ssdr.Skinning | ssdr.MeshSequence, frame: int
) -> Float:
    """Angles (T, 3), degrees, of the normals drawn to those of the reference's surface."""
    truth = surface_normals(reference.frames(frame), model.faces, hard_edges(model))
    if isinstance(model, ssdr.Skinning):
        found = drawn_normals(model, frame)
    else:
        found = surface_normals(model.frames(frame), model.faces, hard_edges(model))
    return np.degrees(np.arccos(np.clip((truth * found).sum(axis=2), -1, 1)))


def per_vertex(faces: NDArray[np.int32], values: Float, n_vertices: int) -> Float:
    """Mean of values (T, 3) at corners, for each vertex; 0 at those without triangles."""
    at = [values[faces == v] for v in range(n_vertices)]
    return np.array([x.mean() if len(x) else 0.0 for x in at])


@dataclasses.dataclass(frozen=True)
class Angles:
    """Stand-in of what ``ssdr.metrics.normals`` returns."""

    mean: float
    p95: float
    beyond_20: float
    inwards: float


def errors(reference: ssdr.MeshSequence, model: ssdr.Skinning | ssdr.MeshSequence) -> Angles:
    """Mean, 95th percentile, share beyond 20° and beyond 90° over all frames and vertices."""
    found = [angles(reference, model, t) for t in range(model.n_frames)]
    every = np.array([per_vertex(model.faces, one, model.n_vertices) for one in found])
    return Angles(
        float(every.mean()),
        float(np.percentile(every, 95, method="inverted_cdf")),
        float((every > 20).mean()),
        float((every > 90).mean()),
    )
