"""Gauss–Newton on the weights and the rest position of each vertex, under given transforms.

The alternation solves weights and rest position one after the other; here they move together.  The
unknowns of a vertex are three coordinates and all its weights except the largest, since weights sum
to 1.  These are at most D = K + 2.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..kernels.polish import polish_vertices
from ..parallel import chunk_bounds, run_chunks, serial_blas
from .model import CHUNK, FREE, Locked, Model
from .moments import transform_sums
from .trajectories import Array, Trajectories

__all__ = ["VertexSystem", "newton_rows", "newton_vertices", "optimise_vertices"]


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
    n, size = data.n_vertices, model.n_influences + 2
    system = VertexSystem(stacked, np.empty((n, size, size)), np.empty((n, size)))
    newton_vertices(
        lambda i, k: data.z[i:k] @ reduced,
        data.x2,
        (gram, gram4),
        model,
        locked=locked,
        entering=entering,
        rounds=rounds,
        inverse=system.inverse,
        gradient=system.gradient,
    )
    return system


def newton_vertices(
    products: Callable[[int, int], Array],
    x2: Array,
    tables: tuple[Array, Array],
    model: Model,
    *,
    locked: Locked,
    entering: int,
    rounds: int,
    inverse: Array | None = None,
    gradient: Array | None = None,
) -> None:
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
    inverse, gradient : (V, D, D), (V, D) arrays, optional
        Outputs: the fields of :class:`VertexSystem`.
    """
    n = len(model.rest)
    keep = locked.vertex_mask(n)

    def work(_: int, i: int, k: int) -> None:
        newton_rows(
            products(i, k),
            x2[i:k],
            tables,
            (model.rest[i:k], model.indices[i:k], model.weights[i:k], model.error[i:k]),
            keep[i:k],
            move_rest=not locked.rest,
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
    """Optimise n vertices as :func:`newton_vertices` does, in the calling thread.

    Parameters
    ----------
    y : (n, 4B) array
        The vertices' rows of Y.
    rows : tuple of arrays
        The vertices' rest positions, indices, weights and errors, all changed in place.
    keep : (n,) bool array
        Mask of the vertices whose weights are locked.
    """
    n, size = len(x2), rows[1].shape[1] + 2
    matrices = np.empty((n, size, size)) if inverse is None else inverse
    gradients = np.empty((n, size)) if gradient is None else gradient
    y = y.reshape(n, 4, len(tables[0]))
    flags = keep, move_rest, entering, rounds
    polish_vertices(y, x2, *tables, *rows, *flags, matrices, gradients)
