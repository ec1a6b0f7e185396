"""Gauss–Newton on the weights and the rest position of each vertex, under given transforms.

The alternation solves weights and rest position one after the other; here they move together.  The
unknowns of a vertex are three coordinates and all its weights except the largest, since weights sum
to 1.  These are at most D = K + 2.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from ..kernels.polish import polish_vertices
from ..parallel import chunk_bounds, run_chunks, serial_blas
from .model import CHUNK, FREE, Locked, Model
from .moments import transform_sums
from .trajectories import Array, Trajectories

__all__ = ["VertexSystem", "newton_vertices", "optimise_vertices"]


@dataclasses.dataclass(frozen=True, eq=False)
class VertexSystem:
    """Gauss–Newton matrices and gradients of all vertices, by which a step eliminates the vertices.

    Attributes
    ----------
    stacked : (3F, 4B) float64
        Transforms of the model, as :meth:`Trajectories.stack` returns them.
    inverse : (V, D, D) float64
        Inverse of each vertex's Gauss–Newton matrix.
    gradient : (V, D) float64
        Half gradient of each vertex's squared error.
    """

    stacked: Array
    inverse: Array
    gradient: Array


@serial_blas()
def optimise_vertices(
    data: Trajectories, model: Model, *, locked: Locked = FREE, entering: int = 3, rounds: int = 2
) -> VertexSystem:
    """Optimise weights and rest pose under the model's transforms (in place).

    No vertex's error rises.

    Parameters
    ----------
    data : Trajectories
    model : Model
    locked : Locked
    entering, rounds : int
        As in :func:`newton_vertices`.

    Returns
    -------
    VertexSystem
        Matrices and gradients at the optimised model.
    """
    stacked, gram, gram4, reduced = transform_sums(data, model.transforms)
    answers = newton_vertices(
        lambda i, k: data.z[i:k] @ reduced,
        data.x2,
        (gram, gram4),
        model,
        locked=locked,
        entering=entering,
        rounds=rounds,
    )
    return VertexSystem(stacked, *answers)


def newton_vertices(
    products: Callable[[int, int], Array],
    x2: Array,
    tables: tuple[Array, Array],
    model: Model,
    *,
    locked: Locked,
    entering: int,
    rounds: int,
) -> tuple[Array, Array]:
    """Optimise weights and rest pose, given sums over the frames (in place).

    Parameters
    ----------
    products : callable
        Called with a range i, k of vertices; returns their rows (k − i, 4B) of the sums Y of
        :mod:`~ssdr.solver.moments`.
    x2 : (V,) array
        Squared length of each vertex's trajectory.
    tables : ((B, 10, B), (B, B, 4, 4)) arrays
        As :func:`~ssdr.solver.moments.gram_tables` returns them.
    model : Model
        Its rest pose, weights and error are changed, its transforms not read.
    locked : Locked
    entering : int
        Largest number of bones that enter a vertex's influences; each enters only if that lowers
        the error.  0: weights are solved on the present influences; −1: weights are not solved
        before the Gauss–Newton steps.
    rounds : int
        Largest number of Gauss–Newton steps of a vertex.

    Returns
    -------
    (V, D, D), (V, D) arrays
        `inverse` and `gradient` of :class:`VertexSystem`.
    """
    n, size = len(model.rest), model.n_influences + 2
    keep, flags = locked.vertex_mask(n), (not locked.rest, entering, rounds)
    inverse, gradient = np.empty((n, size, size)), np.empty((n, size))

    def work(_: int, i: int, k: int) -> None:
        y = products(i, k).reshape(k - i, 4, model.n_bones)
        rows = model.rest[i:k], model.indices[i:k], model.weights[i:k], model.error[i:k]
        answers = inverse[i:k], gradient[i:k]
        polish_vertices(y, x2[i:k], *tables, *rows, keep[i:k], *flags, *answers)

    run_chunks(work, chunk_bounds(n, CHUNK))
    return inverse, gradient
