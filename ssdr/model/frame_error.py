"""Error of a skinning, and size of the motion to reproduce, each in one pass over the frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.parallel import chunk_bounds, run_chunks, serial_blas
from ..kernels.lbs import squared_error_range
from ..mesh.executor import Executor, Frames, Local, SpanTask, spans_of
from ..mesh.sequence import MeshSequence
from .lbs import skin
from .rigid import kabsch

Array = NDArray[np.float64]

_CHUNK = 512  # vertices in a task, as in the solver
_MOST = 500  # frames measured, or a few less
_ROUNDING = 4  # units in the last place of the largest coordinate: less is no motion


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
    """Root mean square error, from the squared errors (V,) of the vertices, summed over frames."""
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
    """Call ``function(frames, transforms, *also, *skinning[:-1])`` for each span.

    `transforms` are the rows of ``skinning[-1]`` for the frames of the span; of the arrays `also`,
    the function gets the same rows.  By default the spans cover all frames.  The results are in the
    order of the spans.
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
    count = sum(map(len, sequences))
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
    """Sum (V, 3) over frames of A_t v^t − v^0, and the sum of its squares.

    A_t is that of :func:`motion_rms`.  A sum of A_t v^t itself would round more.
    """
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
