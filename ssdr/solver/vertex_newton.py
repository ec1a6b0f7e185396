"""Gauss–Newton on the weights and the rest position of each vertex, under given transforms.

The alternation solves weights and rest position one after the other; here they move together.  The
unknowns of a vertex are all its weights except the largest, since weights sum to 1, then three
coordinates of its rest position and, where normals are solved, three of its normal.  These are at
most D = K − 1 + 3P for P points of a vertex.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.parallel import chunk_bounds, run_chunks, serial_blas
from ..kernels.influence_choice import choose_influences
from ..kernels.vertex_polish import polish_vertices
from .model import CHUNK, SOLVED, Constraints, Model
from .moments import transform_sums
from .objective import normal_length, rest_pulls, rest_strength, seen_error
from .rest_surface import RestSurface
from .trajectories import Array, Trajectories


@dataclasses.dataclass(frozen=True, eq=False)
class VertexSystem:
    """Gauss–Newton matrices and gradients with which a step eliminates all vertices.

    Attributes
    ----------
    stacked : (3F, 4B) float64
        Transforms of the model, as :meth:`Trajectories.stack` returns them.
    inverse : (V, D, D) float64
        Inverse of each vertex's Gauss–Newton matrix.
    gradient : (V, D) float64
        Half gradient of each vertex's squared error with the terms of rest pose and normals.
    length : float
        Length of a normal treated as a point.
    strength : float
        Factor λ of the squared changes of edges whose bound is in `inverse`; 0 if none is.
    """

    stacked: Array
    inverse: Array
    gradient: Array
    length: float
    strength: float


@serial_blas()
def optimise_vertices(
    data: Trajectories,
    model: Model,
    *,
    constraints: Constraints,
    entering: int = 3,
    rounds: int = 2,
) -> VertexSystem:
    """Optimise weights and rest pose under the model's transforms (in place).

    No vertex's error rises, counted with its normal and the pull on its rest position.

    Parameters
    ----------
    data : Trajectories
    model : Model
    constraints : Constraints
    entering, rounds : int
        As in :func:`newton_vertices`.

    Returns
    -------
    VertexSystem
        Matrices and gradients at the optimised model.
    """
    stacked, gram, gram4, reduced = transform_sums(data, model.transforms)
    length, hold = normal_length(data, model), rest_pulls(data, model, constraints)
    strength = rest_strength(data, model, constraints)
    inverse, gradient = newton_vertices(
        lambda i, k: data.products(slice(i, k), reduced, length),
        data.squares(slice(None), length),
        (gram, gram4),
        model,
        hold=hold,
        length=length,
        constraints=constraints,
        entering=entering,
        rounds=rounds,
    )
    if data.surface is not None and not constraints.lock_rest:
        # the pulls have moved with the rest pose; their stiffness is the same
        new = rest_pulls(data, model, constraints)
        free = ~constraints.vertex_mask(len(gradient))
        first = np.where(free, np.count_nonzero(model.weights, axis=1) - 1, 0)
        columns = first[:, None] + np.arange(3)
        moved = np.take_along_axis(gradient, columns, axis=1)
        moved += hold[:, :1] * (hold[:, 1:] - new[:, 1:])
        np.put_along_axis(gradient, columns, moved, axis=1)
    return VertexSystem(stacked, inverse, gradient, length, strength)


@serial_blas()
def optimise_some(
    data: Trajectories,
    model: Model,
    rows: NDArray[np.intp],
    surface: RestSurface,
    *,
    constraints: Constraints,
    entering: int,
    times: int,
) -> None:
    """Optimise weights and rest positions of the vertices `rows` alone (in place).

    It repeats what :func:`optimise_vertices` does `times` times, each time with the pulls of
    `surface` at the new rest pose.  Edges that are stiffer there than in the surface of `data` do
    not make the others weaker, as they would in the objective.
    """
    _, gram, gram4, reduced = transform_sums(data, model.transforms)
    some, part = model.select_vertices(rows), constraints.select_vertices(rows)
    for _ in range(times):
        length, error = normal_length(data, model), seen_error(data, model)
        if data.surface is not None:
            error *= surface.factor(model.rest) / data.surface.factor(model.rest)
        newton_vertices(
            lambda i, k, length=length: data.products(rows[i:k], reduced, length),  # type: ignore[misc]
            data.squares(rows, length),
            (gram, gram4),
            some,
            hold=surface.pulls(model.rest, error, data.importance)[rows],
            length=length,
            constraints=part,
            entering=entering,
            rounds=2,
        )
        for name in SOLVED:
            getattr(model, name)[rows] = getattr(some, name)


def newton_vertices(
    products: Callable[[int, int], Array],
    x2: Array,
    tables: tuple[Array, Array],
    model: Model,
    *,
    hold: Array,
    length: float,
    constraints: Constraints,
    entering: int,
    rounds: int,
) -> tuple[Array, Array]:
    """Optimise weights and rest pose, given sums over the frames (in place).

    Parameters
    ----------
    products : callable
        Called with a range i, k of vertices; returns the sums Y (k − i, P, 4, B) of their points,
        see :mod:`~ssdr.solver.moments`.
    x2 : (V, P) array
        Squared norms of the trajectories of each vertex's points.
    tables : ((B, 10, B), (B, B, 4, 4)) arrays
        As :func:`~ssdr.solver.moments.gram_tables` returns them.
    model : Model
        Its rest pose, weights and error are changed, its transforms not read.
    hold : (V, 4) array
        Pulls on the rest positions, in the form of ``RestSurface.pulls``.
    length : float
        Length of a normal treated as a point.
    constraints : Constraints
    entering : int
        Largest number of bones that enter a vertex's influences; each enters only if that lowers
        the error.  If 0, weights are solved on the present influences; if −1, weights are not
        solved before the Gauss–Newton steps.
    rounds : int
        Largest number of Gauss–Newton steps of a vertex.

    Returns
    -------
    (V, D, D), (V, D) arrays
        `inverse` and `gradient` of :class:`VertexSystem`.
    """
    n, size = len(model.rest), model.n_influences - 1 + 3 * x2.shape[1]
    keep, (gram, gram4) = constraints.vertex_mask(n), tables
    inverse, gradient = np.empty((n, size, size)), np.empty((n, size))

    def work(_: int, i: int, k: int) -> None:
        sums = products(i, k), x2[i:k]
        rows = [getattr(model, name)[i:k] for name in SOLVED]
        rest, indices, weights, _, normals, _ = rows
        flags = length, keep[i:k]
        if entering >= 0:
            choose_influences(*sums, gram, rest, indices, weights, normals, *flags, entering)
        system = not constraints.lock_rest, rounds, inverse[i:k], gradient[i:k]
        arrays: Any = *sums, gram4, *rows, hold[i:k], *flags, *system
        polish_vertices(*arrays)

    run_chunks(work, chunk_bounds(n, CHUNK))
    return inverse, gradient
