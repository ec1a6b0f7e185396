"""Gauss–Newton on the weights and the rest position of each vertex, under given transforms.

The alternation solves weights and rest position one after the other; here they move together.  A
vertex has its weights but the largest, which takes up the sum, and three coordinates as unknowns:
at most D = K + 2.
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
    """Gauss–Newton matrices of all vertices at a model, of which bones eliminate the vertices.

    Attributes
    ----------
    stacked : (3F, 4B) float64
        Transforms of the model, as :meth:`Trajectories.stack` stacks them.
    inverse : (V, D, D) float64
        Inverse of each vertex's Gauss–Newton matrix.
    gradient : (V, D) float64
        Half gradient of its squared error.
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
        At the optimised model.
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
    """Optimise weights and rest pose from sums over the frames (in place).

    Parameters
    ----------
    products : callable
        Gives Y = Σ_t v_i^t M^tᵀ of the vertices i..k, (k − i, 4B).
    x2 : (V,) array
        Squared length of each vertex's trajectory.
    tables : ((B, 10, B), (B, B, 4, 4)) arrays
        As :func:`~ssdr.solver.moments.gram_tables` returns them.
    model : Model
        Its rest pose, weights and error are changed, its transforms not read.
    locked : Locked
    entering : int
        Number of bones that may enter a vertex's influences, each if that lowers the error.  0:
        weights are solved on the influences as they are; −1: this solve is left out, too.
    rounds : int
        Most Gauss–Newton steps of a vertex.
    inverse, gradient : (V, D, D), (V, D) arrays, optional
        Receive the fields of :class:`VertexSystem`.
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
    """Do what :func:`newton_vertices` does for some vertices in the calling thread.

    Parameters
    ----------
    y : (n, 4B) array
        Their rows of Y.
    rows : tuple of arrays
        Their rest positions, indices, weights and errors, all changed in place.
    keep : (n,) bool array
        Vertices whose weights stay.
    """
    n, size = len(x2), rows[1].shape[1] + 2
    matrices = np.empty((n, size, size)) if inverse is None else inverse
    gradients = np.empty((n, size)) if gradient is None else gradient
    y = y.reshape(n, 4, len(tables[0]))
    flags = keep, move_rest, entering, rounds
    polish_vertices(y, x2, *tables, *rows, *flags, matrices, gradients)
