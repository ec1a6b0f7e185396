"""Rank of a motion: a lower bound on the number of bones, and a compression of the frames."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..parallel import serial_blas
from ..solver.trajectories import Trajectories, truncated_basis

__all__ = ["rank_bound", "rank_of", "reduced"]

_SPECTRUM = 2000  # size of the largest Gram matrix whose eigenvalues are computed
_NOISE = 1e-12  # energy of rounding errors, relative to the whole
_TAIL = 1e-4  # squared error that the compression may lose, relative to the allowed one


def rank_bound(data: Trajectories, allowed: float) -> int:
    """Lower bound on the number of bones that can reach the allowed squared error.

    A model of B bones moves V vertices through F frames by a (V, 4B) times a (4B, 3F) matrix.
    Relative to the centroids of the frames its rank is at most 4B − 1, since weights sum to 1.  By
    Eckart and Young (1936) the squared error is at least the energy beyond that rank, for rigid,
    similarity and affine bones.  The bound is 1 if the spectrum is too large to compute.
    """
    return max(1, -(-(rank_of(data, allowed) + 1) // 4))


def rank_of(data: Trajectories, allowed: float) -> int:
    """Least rank that leaves at most the allowed squared error; 0 if too large to compute."""
    if min(data.z.shape) > _SPECTRUM:
        return 0
    x = data.z
    with serial_blas():
        values = np.linalg.eigvalsh(x @ x.T if x.shape[1] > x.shape[0] else x.T @ x)[::-1]
    energy = float(values.sum())
    tail = np.append(np.cumsum(values[::-1])[::-1], 0.0)
    return int(np.argmax(tail <= max(allowed, _NOISE * energy)))


def reduced(data: Trajectories, allowed: float) -> Trajectories:
    """The frames in as few columns as the allowed squared error needs."""
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
