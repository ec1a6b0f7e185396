"""Normals of surfaces, and of models as engines draw them, by loops."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import ssdr
from helpers import naive

Float = NDArray[np.float64]


def surface_normals(points: Float, faces: NDArray[np.int32], hard: Float | None = None) -> Float:
    """Normals (T, 3, 3) by the angles of the triangles; corners with equal `hard` share one."""
    key = faces.reshape(-1, 1)
    if hard is not None:
        key = np.concatenate([key, hard.reshape(-1, 3)], axis=1)
    groups = np.unique(key, axis=0, return_inverse=True)[1].reshape(-1, 3)
    return np.asarray(naive.corner_normals(points, faces, groups))


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
