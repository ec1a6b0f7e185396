"""Error of a skinning against all frames, in one pass over them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..kernels.lbs import squared_error_range
from ..parallel import chunk_bounds, run_chunks
from ..sequence import MeshSequence
from ..skinning import skin
from .executor import Executor, Frames, Local, SpanTask, spans_of

__all__ = ["largest_error", "squared_error"]

Array = NDArray[np.float64]

_CHUNK = 512  # vertices in a chunk of work, as in the solver


def squared_error(
    sequences: Sequence[MeshSequence],
    rest: Array,
    indices: NDArray[np.int32],
    weights: Array,
    transforms: Array,
    *,
    executor: Executor | None = None,
) -> Array:
    """Squared error of each vertex, summed over the frames: (V,) Σ_t |d|²."""
    task = _task(_squared_error_of_span, sequences, rest, indices, weights, transforms)
    total = np.zeros(len(rest))
    for part in (executor or Local()).map(task):
        total += part
    return total


def largest_error(
    sequences: Sequence[MeshSequence],
    rest: Array,
    indices: NDArray[np.int32],
    weights: Array,
    transforms: Array,
    *,
    executor: Executor | None = None,
) -> float:
    """Largest distance |d| of any vertex in any frame."""
    task = _task(_largest_square_of_span, sequences, rest, indices, weights, transforms)
    # max would pass over NaN.
    return math.sqrt(np.max(list((executor or Local()).map(task))))


def _task(
    function: Callable[..., object],
    sequences: Sequence[MeshSequence],
    rest: Array,
    indices: NDArray[np.int32],
    weights: Array,
    transforms: Array,
) -> SpanTask:
    spans = spans_of(len(transforms))
    return SpanTask(
        function,
        sequences,
        spans,
        lambda k: (transforms[slice(*spans[k])],),
        (rest, indices, weights),
    )


def _squared_error_of_span(
    frames: Frames, transforms: Array, rest: Array, indices: NDArray[np.int32], weights: Array
) -> Array:
    total = np.zeros(len(rest))
    for start, block in frames.blocks():
        target = np.ascontiguousarray(block, dtype=np.float64)
        moves = np.ascontiguousarray(transforms[start : start + len(block)])

        def work(_: int, i: int, k: int, target: Array = target, moves: Array = moves) -> None:
            squared_error_range(rest, indices, weights, moves, target, i, k, total)

        run_chunks(work, chunk_bounds(len(rest), _CHUNK))
    return total


def _largest_square_of_span(
    frames: Frames, transforms: Array, rest: Array, indices: NDArray[np.int32], weights: Array
) -> float:
    largest = 0.0
    for start, block in frames.blocks():
        moves = transforms[start : start + len(block)]
        d = skin(rest, indices, weights, moves, dtype=np.float64) - block
        largest = float(np.maximum(largest, np.einsum("tic,tic->ti", d, d).max()))
    return largest
