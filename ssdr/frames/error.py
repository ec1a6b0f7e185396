"""Error of a skinning, computed in one pass over all frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..kernels.lbs import squared_error_range
from ..parallel import chunk_bounds, run_chunks
from ..sequence import MeshSequence
from ..skinning import skin
from .executor import Executor, Frames, Local, SpanTask, spans_of

__all__ = ["largest_error", "of_each_span", "rmse", "rmse_of", "squared_error"]

Array = NDArray[np.float64]

_CHUNK = 512  # vertices in a task, as in the solver


def squared_error(
    sequences: Sequence[MeshSequence], *skinning: Any, executor: Executor | None = None
) -> Array:
    """Squared distance Σ_t |d|² of each vertex to its target, summed over all frames t: (V,).

    Parameters
    ----------
    sequences : sequence of MeshSequence
        Target vertices, with the frames of one sequence after those of the other.
    *skinning : arrays
        Rest pose, indices, weights and transforms, as :func:`ssdr.skin` takes them.
    executor : Executor, optional
        Where the work is done; in this process by default.
    """
    total = np.zeros(len(skinning[0]))
    for part in of_each_span(_squared_error_of_span, sequences, skinning, executor):
        total += part
    return total


def rmse(
    sequences: Sequence[MeshSequence], *skinning: Any, executor: Executor | None = None
) -> float:
    """Root mean square of the distances |d|; arguments as in :func:`squared_error`."""
    return rmse_of(squared_error(sequences, *skinning, executor=executor), len(skinning[-1]))


def rmse_of(squared: Array, n_frames: int) -> float:
    """Root mean square error of the squared errors of each vertex, summed over all frames."""
    return math.sqrt(float(squared.sum()) / (n_frames * len(squared)))


def largest_error(
    sequences: Sequence[MeshSequence], *skinning: Any, executor: Executor | None = None
) -> float:
    """Largest distance |d| of a vertex to its target; arguments as in :func:`squared_error`."""
    squares = list(of_each_span(_largest_square_of_span, sequences, skinning, executor))
    return math.sqrt(np.max(squares))  # NumPy's maximum, since Python's skips NaN


def of_each_span(
    function: Callable[..., Any],
    sequences: Sequence[MeshSequence],
    skinning: Sequence[Any],
    executor: Executor | None,
    spans: list[tuple[int, int]] | None = None,
    also: Sequence[Any] = (),
) -> Iterator[Any]:
    """Results of ``function(frames, transforms, *also, *skinning[:-1])`` for each span, in order.

    `transforms` are those of the frames of the span, out of ``skinning[-1]``, and `also` are
    arrays of which the function gets these frames, too.  By default the spans cover all frames.
    """
    *bound, transforms = skinning
    spans = spans_of(len(transforms)) if spans is None else spans

    def own(k: int) -> tuple[Any, ...]:
        return tuple(array[slice(*spans[k])] for array in (transforms, *also))

    return (executor or Local()).map(SpanTask(function, sequences, spans, own, tuple(bound)))


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
