"""Gauss–Newton on the weights and the rest position of every vertex, on the support that it has.

What the alternation's vertex step solves one after the other moves together here: a vertex has
its free weights and three coordinates, a dense system of at most K + 2 unknowns.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..kernels.polish import polish_vertices
from ..parallel import chunk_bounds, run_chunks
from .model import CHUNK, Fixed, Model
from .trajectories import Array

__all__ = ["newton_rows", "newton_vertices"]


def newton_vertices(
    products: Callable[[int, int], Array],
    x2: Array,
    tables: tuple[Array, Array],
    model: Model,
    *,
    fixed: Fixed,
    entering: int,
    rounds: int,
    inverse: Array | None = None,
    gradient: Array | None = None,
) -> None:
    """Weights, rest pose and error of a model's vertices (in place).

    Parameters
    ----------
    products : callable
        Y = Σ_t v_i^t M^tᵀ of the vertices i..k, as (k − i, 4B).
    x2 : (V,) array
        Squared length of each vertex's trajectory.
    tables : ((B, 10, B), (B, B, 4, 4)) arrays
        Those of :func:`~ssdr.solver.moments.gram_tables`.
    model : Model
    fixed : Fixed
    entering : int
        Bones that may enter a vertex's support; −1: none, and weights stay (with 0 rounds
        only `inverse` and `gradient` are computed).
    rounds : int
        Of Gauss–Newton.
    inverse, gradient : (V, K + 2, K + 2), (V, K + 2) arrays, optional
        Receive the inverse of each vertex's Gauss–Newton matrix, and its half gradient.
    """
    n = len(model.rest)
    keep = fixed.keep_weights(n)

    def work(_: int, i: int, k: int) -> None:
        newton_rows(
            products(i, k),
            x2[i:k],
            tables,
            (model.rest[i:k], model.indices[i:k], model.weights[i:k], model.error[i:k]),
            keep[i:k],
            move_rest=not fixed.rest,
            entering=entering,
            rounds=rounds,
            inverse=None if inverse is None else inverse[i:k],
            gradient=None if gradient is None else gradient[i:k],
        )

    run_chunks(work, chunk_bounds(n, CHUNK))


def newton_rows(
    y: Array,
    x2: Array,
    tables: tuple[Array, Array],
    rows: tuple[Array, NDArray[np.int32], Array, Array],
    keep: NDArray[np.bool_],
    *,
    move_rest: bool,
    entering: int,
    rounds: int,
    inverse: Array | None = None,
    gradient: Array | None = None,
) -> None:
    """The same for some vertices, whose rest, indices, weights and error are `rows`."""
    rest, indices, weights, error = rows
    gram, gram4 = tables
    n, size = len(rest), indices.shape[1] + 2
    polish_vertices(
        y.reshape(n, 4, len(gram)),
        x2,
        gram,
        gram4,
        rest,
        indices,
        weights,
        error,
        keep,
        move_rest,
        entering,
        rounds,
        np.empty((n, size, size)) if inverse is None else inverse,
        np.empty((n, size)) if gradient is None else gradient,
        0,
        n,
    )
