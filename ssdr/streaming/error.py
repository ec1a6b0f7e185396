"""Squared error against the frames themselves, in one walk over all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..kernels.lbs import squared_error_range
from ..parallel import chunk_bounds, run_chunks
from ..sequence import MeshSequence
from ..solver.model import CHUNK
from ..solver.trajectories import Array
from .executor import Executor, Frames, Local, Walk, spans_of

__all__ = ["squared_error"]


def squared_error(
    sequences: Sequence[MeshSequence],
    rest: Array,
    joints: NDArray[np.int32],
    weights: Array,
    transforms: Array,
    *,
    executor: Executor | None = None,
) -> Array:
    """(V,) Σ_t |d|² against the frames themselves, in one walk over all of them."""
    spans = spans_of(len(transforms))
    walk = (executor or Local()).map(
        Walk(
            _error_span, sequences, spans, lambda k: (transforms[slice(*spans[k])],),
            (rest, joints, weights),
        )
    )  # fmt: skip
    total = np.zeros(len(rest))
    for part in walk:
        total += part
    return total


def _error_span(
    frames: Frames, transforms: Array, rest: Array, joints: NDArray[np.int32], weights: Array
) -> Array:
    total = np.zeros(len(rest))
    for start, block in frames.blocks():
        target = np.ascontiguousarray(block, dtype=np.float64)
        moves = np.ascontiguousarray(transforms[start : start + len(block)])

        def work(_: int, i: int, k: int, target: Array = target, moves: Array = moves) -> None:
            squared_error_range(rest, joints, weights, moves, target, i, k, total)

        run_chunks(work, chunk_bounds(len(rest), CHUNK))
    return total
