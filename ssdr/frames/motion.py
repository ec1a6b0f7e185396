"""Size of the motion that a model has to reproduce: what no single rigid motion explains."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..parallel import serial_blas
from ..rigid import kabsch
from ..sequence import MeshSequence
from .error import of_each_span
from .executor import Executor, Frames, spans_of

__all__ = ["motion_rms", "share_of"]

Array = NDArray[np.float64]

_MOST = 500  # frames measured, or a few less
_ROUNDING = 4  # units in the last place of the largest coordinate: less is no motion


def motion_rms(sequences: Sequence[MeshSequence], *, executor: Executor | None = None) -> float:
    """Root mean square distance of the vertices from their mean pose, without rigid motion.

    With A_t the rigid motion that carries frame t onto the first with least squared error, and m
    the mean over all frames of A_t v^t, it is √(Σ_t Σ_i ‖A_t v_i^t − m_i‖² / (F V)), over about 500
    frames at most.  It is 0 where all of it may be rounding of the coordinates.

    Parameters
    ----------
    sequences : sequence of MeshSequence
        Shots of one mesh.
    executor : Executor, optional
        Where the work is done; in this process by default.

    References
    ----------
    Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976.
    """
    first = np.asarray(sequences[0].frames(0), dtype=np.float64)
    count = sum(len(shot) for shot in sequences)
    spans = spans_of(count, _MOST)
    total, squares = np.zeros_like(first), 0.0
    pose = first, np.zeros((count, 0))
    with serial_blas():
        for moved, squared in of_each_span(_sums_of_span, sequences, pose, executor, spans):
            total += moved
            squares += squared
    n = sum(stop - start for start, stop in spans)
    mean = math.sqrt(max(0.0, squares - float((total**2).sum()) / n) / (n * len(first)))
    eps = max(float(np.finfo(shot.vertices.dtype).eps) for shot in sequences)
    return mean if mean > _ROUNDING * eps * float(np.abs(first).max()) else 0.0


def _sums_of_span(frames: Frames, _: Array, first: Array) -> tuple[Array, float]:
    """Sum over frames, and sum of the squares, of A_t v^t − v^0, which rounds less than A_t v^t."""
    total, squares = np.zeros_like(first), 0.0
    for _start, block in frames.blocks():
        points = np.asarray(block, dtype=np.float64)
        moves = kabsch(points, first)
        apart = points @ np.swapaxes(moves[..., :3], 1, 2) + moves[:, None, :, 3] - first
        total += apart.sum(axis=0)
        squares += float((apart**2).sum())
    return total, squares


def share_of(rmse: float, motion: float) -> float:
    """Share rmse / motion of the motion that is lost; NaN where there is no motion."""
    return rmse / motion if motion > 0 else math.nan
