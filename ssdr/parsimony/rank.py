"""Rank of a motion: a lower bound on the number of bones, and a compression of the frames."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..common.parallel import serial_blas
from ..solver.trajectories import Trajectories, truncated_basis

_SPECTRUM = 2000  # size of the largest Gram matrix whose eigenvalues are computed
_NOISE = 1e-12  # sum of squares that counts as rounding errors, relative to that of all entries
_TAIL = 1e-4  # squared error that the compression may add, relative to the allowed one


def rank_bound(data: Trajectories, allowed: float) -> int:
    """Lower bound on the number of bones that can reach the allowed squared error.

    The positions of V vertices in F frames under B bones are a (V, 4B) matrix times a (4B, 3F)
    matrix.  Relative to the centroid of each frame, the rank of this product is at most 4B − 1,
    since weights sum to 1.  By Eckart and Young (1936) the squared error is at least the sum of the
    squared singular values beyond that rank.  This holds for rigid, similarity and affine bones.
    The bound is 1 if there are too many singular values to compute.
    """
    return max(1, -(-(rank_of(data, allowed) + 1) // 4))


def rank_of(data: Trajectories, allowed: float) -> int:
    """Least rank with which a matrix approximates the trajectories to the allowed squared error.

    It is 0 if there are too many singular values to compute.
    """
    if min(data.z.shape) > _SPECTRUM:
        return 0
    x = data.z
    with serial_blas():
        values = np.linalg.eigvalsh(x @ x.T if x.shape[1] > x.shape[0] else x.T @ x)[::-1]
    energy = float(values.sum())
    tail = np.append(np.cumsum(values[::-1])[::-1], 0.0)
    return int(np.argmax(tail <= max(allowed, _NOISE * energy)))


def reduced(data: Trajectories, allowed: float) -> Trajectories:
    """Compress the trajectories to as few columns as the allowed squared error permits."""
    if min(data.z.shape) > _SPECTRUM:
        return data
    with serial_blas():
        x = data.z * np.sqrt(data.importance)[:, None]
        basis = truncated_basis(x, lambda tail: max(_TAIL * allowed, 1e-15 * tail[0]))
        if basis is None:
            return data
        z = np.ascontiguousarray(data.z @ basis)
        q = basis if data.q is None else np.ascontiguousarray(data.q @ basis)
    return dataclasses.replace(data, z=z, q=q)
