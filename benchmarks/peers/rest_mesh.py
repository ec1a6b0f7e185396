"""The rest mesh of a model: its own normals beside the stored ones, and what is folded."""

from __future__ import annotations

from typing import Any

import numpy as np


def corner_normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3) of a mesh: those of the triangles, weighted by their angles."""
    corners = points[faces]
    along, back = np.roll(corners, -1, 1) - corners, np.roll(corners, 1, 1) - corners
    area = np.cross(along[:, 0], back[:, 0])
    lengths = np.linalg.norm(along, axis=2) * np.linalg.norm(back, axis=2)
    cosine = (along * back).sum(axis=2) / np.maximum(lengths, 1e-300)
    each = np.arccos(np.clip(cosine, -1, 1))[..., None] * unit(area)[:, None]
    out = np.zeros_like(points)
    np.add.at(out, faces, each)
    return unit(out)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def folded(points: np.ndarray, normals: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Mask (T,) of triangles that point against the normals (V, 3) of their vertices."""
    a, b, c = points[faces].transpose(1, 0, 2)
    return (np.cross(b - a, c - a) * normals[faces].sum(axis=1)).sum(axis=1) < 0


def measured(model: Any, frames: np.ndarray, faces: np.ndarray) -> dict[str, float]:
    """Degrees from the stored normals to the rest mesh's own, and triangles that are turned over.

    A triangle is, where it points against the normals of its vertices and does so in no frame.
    """
    own, found = corner_normals(model.rest, faces), {}
    if model.surface is not None:
        stored = np.zeros_like(model.rest)
        stored[faces] = model.surface.normals
        known = own.any(axis=1) & stored.any(axis=1)
        cosine = (own * stored).sum(axis=1)[known]
        found["bent"] = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())
    over = folded(model.rest, own, faces)
    for points in frames:
        if not over.any():
            break
        points = np.asarray(points, dtype=np.float64)
        over &= ~folded(points, corner_normals(points, faces), faces)
    return found | {"turned over": int(over.sum())}
