"""Normals of a model with shapes: those of the rest pose, and the vectors that each shape adds."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..normals import NormalHolders, corner_normals, normal_holders, surface_normals
from ..shapes import ShapedSkinning
from .vector_fit import fit_vectors

Array = NDArray[np.float64]

_PULL = 1e-3  # towards the initial normals, relative to the sum of squared amounts
_LEAST = 1e-6  # norm of a fitted normal: a smaller one has no direction
_MOST = 500  # frames that normals are fitted to


@dataclasses.dataclass(frozen=True, eq=False)
class ShapedNormals:
    """Normals of a rest pose, and the vectors that shapes add to them.

    Attributes
    ----------
    corner : (T, 3) int32
        Index of the normal at each triangle corner.
    rest : (N, 3) float64
        Unit normals.
    added : (S, N, 3) float64
    """

    corner: NDArray[np.int32]
    rest: Array
    added: Array


def shaped_normals(face: ShapedSkinning) -> ShapedNormals:
    """Fit rest normals n, and a vector d_s added by each shape, to the model's deformed surface.

    With a_t the amounts in frame t, an engine shades with A_t (n + Σ_s a_ts d_s), normalised, where
    A_t is the blended 3×3 matrix.  At triangles that shapes move, n and d are fitted by least
    squares to the normals of the model's surface in at most 500 frames, evenly spaced.  Elsewhere n
    is the model's own normal, and d is 0.  Where the frames leave d_s undetermined, it is the
    change that shape s makes to the rest surface's normal.
    """
    model, shapes, faces = face.skinning, face.shapes, face.faces
    holders = normal_holders(faces, model.n_vertices, model.surface)
    rest, count = np.asarray(model.rest, dtype=np.float64), len(holders.vertex)
    own = None if model.surface is None else model.surface.normals
    given = corner_normals(rest, faces, None) if own is None else own
    start = surface_normals(np.concatenate([rest[None], rest + shapes.displacements]), holders)
    start -= start[:1]
    start[0, holders.corner] = given
    reached = np.zeros((len(shapes), count), dtype=bool)
    for s in range(len(shapes)):
        touched = np.flatnonzero(np.any(shapes.displacements[s], axis=1))
        reached[s, holders.corner[np.isin(faces, touched).any(axis=1)]] = True
    found = np.concatenate([start[:1], np.where(reached[..., None], start[1:], 0.0)])
    frames = np.linspace(0, model.n_frames - 1, min(_MOST, model.n_frames)).astype(int)
    targets = _targets(face, frames, holders)
    solved = fit_vectors(
        face,
        frames,
        targets,
        vertex=holders.vertex,
        used=np.concatenate([np.any(reached, axis=0, keepdims=True), reached]),
        start=start,
        pull=_PULL,
        known=np.any(targets, axis=2),
    )
    size = np.linalg.norm(solved[0], axis=1)
    fitted = np.flatnonzero(reached.any(axis=0) & (size > _LEAST))
    found[:, fitted] = solved[:, fitted] / size[fitted, None]
    return ShapedNormals(holders.corner, found[0], found[1:])


def _targets(face: ShapedSkinning, frames: NDArray[np.int64], holders: NormalHolders) -> Array:
    """Normals ``(f, N, 3)`` of the model's deformed surface in some frames."""
    out = np.empty((len(frames), len(holders.vertex), 3))
    for k, frame in enumerate(frames):
        out[k] = surface_normals(face.skin([frame], dtype=np.float64), holders)[0]
    return out
