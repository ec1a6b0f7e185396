"""Morph targets of an animation: principal components of what its bones leave."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from ssdr import ShapedSkinning, Shapes, Skinning
from ssdr.common.parallel import serial_blas
from ssdr.model.shaped_normals import fit_vectors

Array = NDArray[np.float64]

_PULL = 1e-9  # pull towards displacements of 0, relative to the sum of squared amounts
_FLAT = 0.1  # singular values of a blended matrix below this share of the largest are not inverted
_ROUNDS = 8  # alternations
_SETTLED = 1e-3  # relative fall of the error below which they end


@serial_blas()
def with_morph_targets(model: Skinning, truth: Array, count: int) -> ShapedSkinning:
    """A model with at most `count` shapes, whose amounts are from 0 to 1.

    Displacements and amounts are solved in turns.  They start from the principal components of the
    residual, mapped back to the rest pose (Kavan, Sloan and O'Sullivan, "Fast and efficient
    skinning of animated meshes", 2010).  The rest pose may move.
    """
    left = truth - model.skin(dtype=np.float64)
    turns, error = _blended(model), math.inf
    amounts = _components(turns, left)[:, :count]
    used = np.ones((1 + amounts.shape[1], model.n_vertices), dtype=bool)
    start = np.zeros((*used.shape, 3))
    for _ in range(_ROUNDS):
        rest, *moved = fit_vectors(
            ShapedSkinning(model, Shapes(start[1:], amounts)),
            np.arange(model.n_frames),
            left,
            vertex=np.arange(model.n_vertices),
            used=used,
            start=start,
            pull=_PULL,
        )
        posed = np.stack([(turns @ d[..., None]).reshape(len(left), -1) for d in moved], axis=1)
        goal = (left - (turns @ rest[..., None])[..., 0]).reshape(len(left), -1, 1)
        gram = posed @ posed.swapaxes(1, 2)
        ridge = 1e-12 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-300
        amounts = np.linalg.solve(gram + ridge * np.eye(len(moved)), posed @ goal)[..., 0]
        before, error = error, float(((goal[..., 0] - (amounts[:, None] @ posed)[:, 0]) ** 2).sum())
        if error > (1 - _SETTLED) * before:
            break
    low, span = amounts.min(axis=0), np.ptp(amounts, axis=0)
    scale = np.where(span > 0, span, 1.0)
    both = np.stack(moved)
    shapes = Shapes(scale[:, None, None] * both, (amounts - low) / scale)
    rest = np.asarray(model.rest) + rest + np.tensordot(low, both, 1)
    return ShapedSkinning(dataclasses.replace(model, rest=rest), shapes)


def _blended(model: Skinning) -> Array:
    """Blended 3×3 matrix of each vertex in every frame, ``(F, V, 3, 3)``."""
    weights = model.sparse_weights().astype(np.float64)
    linear = np.asarray(model.transforms, dtype=np.float64)[..., :3].swapaxes(0, 1)
    turns = weights @ linear.reshape(model.n_bones, -1)
    return np.asarray(turns).reshape(model.n_vertices, -1, 3, 3).swapaxes(0, 1)


def _components(turns: Array, left: Array) -> Array:
    """Amounts ``(F, P)`` of the principal components of the residual `left` in the rest pose."""
    size = np.linalg.norm(turns, axis=(2, 3))[..., None] / math.sqrt(3)
    back = (np.linalg.pinv(turns, rcond=_FLAT) @ left[..., None])[..., 0]
    mean = (size**2 * back).sum(axis=0) / np.maximum((size**2).sum(axis=0), 1e-300)
    rows = (size * (back - mean)).reshape(len(left), -1)
    return np.linalg.eigh(rows @ rows.T)[1][:, ::-1]
