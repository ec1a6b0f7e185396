"""Normals and tangents that follow a mesh into another pose, as the artist has set them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["carry_normals", "carry_tangents"]


def carry_normals(
    normals: NDArray[np.float64],
    holder: NDArray[np.integer],
    faces: NDArray[np.integer],
    source: NDArray[np.float64],
    target: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Normals of a mesh in another pose.

    Each triangle that meets in a normal turns and stretches it along (its cofactors); the mean is
    weighted by the angle there.  Where the mesh has moved rigidly, this is the same motion.

    Parameters
    ----------
    normals : (N, 3) array
        In the pose `source`.
    holder : (T, 3) int array
        The normal of each corner.
    faces : (T, 3) int array
    source, target : (V, 3) arrays
        Vertices in both poses.

    Returns
    -------
    (N, 3) float32
        Unit normals; those of no usable triangle stay as they are.
    """
    return _carry(normals, holder, faces, source, target, cofactors=True)


def carry_tangents(
    tangents: NDArray[np.float64],
    normals: NDArray[np.floating],
    holder: NDArray[np.integer],
    faces: NDArray[np.integer],
    source: NDArray[np.float64],
    target: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Tangents ``(N, 4)`` in another pose, at right angles to its `normals`; signs stay."""
    moved = _carry(tangents[:, :3], holder, faces, source, target, cofactors=False)
    along = (moved * normals).sum(axis=1, keepdims=True)
    flat = moved - along * normals
    length = np.linalg.norm(flat, axis=1, keepdims=True)
    unit = np.where(length > 1e-6, flat / np.where(length > 1e-6, length, 1.0), moved)
    return np.concatenate([unit, tangents[:, 3:]], axis=1).astype(np.float32)


def _carry(
    vectors: NDArray[np.float64],
    holder: NDArray[np.integer],
    faces: NDArray[np.integer],
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    *,
    cofactors: bool,
) -> NDArray[np.float32]:
    before, sound = _frames(source, faces)
    after, also = _frames(target, faces)
    sound &= also
    before[~sound] = np.eye(3)
    after[~sound] = np.eye(3)
    # Columns: two edges and the unit normal.  after @ inv(before) carries the one to the other.
    gradient = after @ np.linalg.inv(before)
    if cofactors:
        gradient = np.swapaxes(np.linalg.inv(gradient), -1, -2)
    corners = vectors[holder]
    moved = np.einsum("tij,tcj->tci", gradient, corners)
    length = np.linalg.norm(moved, axis=2, keepdims=True)
    moved = np.where(length > 0, moved / np.where(length > 0, length, 1.0), 0.0)
    moved *= np.where(sound[:, None], _angles(target[faces]), 0.0)[..., None]
    sums = np.stack(
        [np.bincount(holder.ravel(), moved[..., c].ravel(), len(vectors)) for c in range(3)], axis=1
    )
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    usable = length > 1e-9
    return np.where(usable, sums / np.where(usable, length, 1.0), vectors).astype(np.float32)


def _frames(
    points: NDArray[np.float64], faces: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    p = points[faces]
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    normal = np.cross(a, b)
    area = np.linalg.norm(normal, axis=1, keepdims=True)
    size = np.maximum((a**2).sum(axis=1), (b**2).sum(axis=1))
    sound = (area[:, 0] > 1e-9 * size) & (area[:, 0] > 1e-300)
    normal = np.where(sound[:, None], normal / np.where(area > 0, area, 1.0), 0.0)
    return np.stack([a, b, normal], axis=2), sound


def _angles(p: NDArray[np.float64]) -> NDArray[np.float64]:
    toward = np.roll(p, -1, axis=1) - p
    back = np.roll(p, 1, axis=1) - p
    cross = np.linalg.norm(np.cross(toward, back), axis=2)
    return np.asarray(np.arctan2(cross, (toward * back).sum(axis=2)))
