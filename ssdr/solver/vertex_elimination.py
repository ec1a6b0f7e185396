"""Normal equations of the bones with weights and rest pose eliminated, as a Schur complement.

No term couples the unknowns v of two vertices, so H_vv consists of one small block for each vertex,
whose inverse the vertex step returns.  The system that remains for the stacked transforms m has the
matrix H_mm − H_mv H_vv⁻¹ H_vm.  A product with it takes sums over frames (4B, 4B), then sums over
vertices, but never an array of vertices × frames.

References
----------
Triggs et al., "Bundle adjustment: a modern synthesis", 2000, section 6.1 (the same structure).
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..common.parallel import chunk_bounds, run_chunks
from ..kernels.schur import apply_vertex_step, schur_vertices
from .model import CHUNK, Constraints, Model
from .moments import bone_sums, stack_blocks
from .trajectories import Array, Trajectories
from .vertex_newton import VertexSystem

# Fewest rows and multiplications of a piece: small products are slow, and handing them to threads
# costs more than it saves.
_PIECE, _MULTIPLICATIONS = 96, 2_000_000

# most tasks: each needs memory for its own (B, B, 4, 4) sums, but fewer tasks would use fewer cores
_TASKS = 8


class _Groups(NamedTuple):
    """Arguments of :func:`schur_vertices`: vertices in groups that the same bones move."""

    start: NDArray[np.intp]  # (G + 1,) first vertex of each group
    bones: NDArray[np.intp]  # (G, K) bones of each group, ascending, padded with B
    sizes: NDArray[np.intp]  # (G,) number of bones of each group
    slot: NDArray[np.intp]  # (V, K) column of each of the group's bones in the model's weights
    points: Array
    weights: Array  # (V, K) in the order of the group's bones
    importance: Array
    free: NDArray[np.bool_]
    inverse: Array
    gradient: Array


class ReducedSystem:
    """Normal equations of a model's transforms, with the unknowns of the vertices eliminated.

    Vertices are grouped by the set of bones that move them, so that one block of the sums over
    frames serves a whole group, and products read memory from front to back.

    Parameters
    ----------
    data : Trajectories
    model : Model
        As :func:`~ssdr.solver.vertex_newton.optimise_vertices` left it.
    constraints : Constraints
    vertices : VertexSystem
        The result of the same call.
    precision : type
        Data type of products; the gradient is float64.

    Attributes
    ----------
    u : (B, B, 4, 4) float64
        Σ_i w_j w_k p̃ p̃ᵀ.  Multiplied by the importance of a frame, it is H_mm of each axis of the
        frame.
    gradient : (3F, 4B) float64
        Half gradient of the squared error and the terms of rest pose and normals with respect to
        the stacked transforms, with the vertices at their optimum.
    """

    def __init__(
        self,
        data: Trajectories,
        model: Model,
        constraints: Constraints,
        vertices: VertexSystem,
        precision: type[np.floating[Any]],
    ) -> None:
        self.n_bones = model.n_bones
        self.keep, self.move_rest = constraints.vertex_mask(data.n_vertices), not constraints.rest
        n = data.n_vertices
        self._tasks = chunk_bounds(n, max(CHUNK, -(-n // _TASKS)))
        self._order, self._groups = _group(data, model, self.keep, vertices, precision)
        self.length = vertices.length
        self.u, c = bone_sums(data, model, length=self.length)
        stacked, u = vertices.stacked, stack_blocks(self.u)
        c *= data.frame_scale[:, None, None, None]
        _, answer = self._eliminate(np.zeros_like(u), 1.0)
        self.gradient = product(stacked, u - answer) - c.reshape(stacked.shape)
        self.stacked, self.u_flat = (x.astype(precision, copy=False) for x in (stacked, u))

    def times(self, change: Array) -> Array:
        """Product of the Schur complement and a change (3F, 4B) of the stacked transforms."""
        _, answer = self._eliminate(cross_product(self.stacked, change), 0.0)
        answer = answer.astype(change.dtype, copy=False)
        return product(change, self.u_flat) - product(self.stacked, answer)

    def best_step(self, change: Array) -> Array:
        """Step (V, D) to subtract from the vertices' unknowns, the best for this change."""
        grouped, _ = self._eliminate(cross_product(self.stacked, change), 1.0)
        step = np.empty(grouped.shape)
        step[self._order] = grouped
        return step

    def move_vertices(self, model: Model, change: Array) -> None:
        """Move weights and rest pose of `model`, a trial copy (in place).

        The step is the best one for the change `change` of the stacked transforms.
        """
        step = self.best_step(change)

        def work(_: int, i: int, k: int) -> None:
            names = ("rest", "normals", "indices", "weights")
            rows = [getattr(model, name)[i:k] for name in names]
            arrays: Any = step[i:k], *rows, self.length, self.keep[i:k], self.move_rest
            apply_vertex_step(*arrays)

        run_chunks(work, self._tasks)

    def _eliminate(self, cross: Array, share: float) -> tuple[Array, Array]:
        """Response of the vertices to a change δM of the transforms, and the effect on the bones.

        Parameters
        ----------
        cross : (4B, 4B) array
            Transpose of the stacked transforms times their change.
        share : float
            Factor 0 or 1 of the vertices' own gradient in the step.

        Returns
        -------
        step : (V, D) array
            H_vv⁻¹ (H_vm δM + share · gradient), in the order of the groups.
        answer : (4B, 4B) array
            Matrix whose product with the stacked transforms is H_mv times the step.
        """
        n_bones, groups = self.n_bones, self._groups
        step = np.empty_like(groups.gradient)
        table = np.ascontiguousarray(
            cross.reshape(4, n_bones, 4, n_bones).transpose(3, 1, 2, 0), dtype=step.dtype
        )

        def work(_: int, i: int, k: int) -> Array:
            total = np.zeros((n_bones, n_bones, 4, 4))
            schur_vertices(table, *groups, share, step, total, self.move_rest, i, k)
            return total

        cuts = np.searchsorted(groups.start, [0, *(k for _, k in self._tasks)])
        parts = run_chunks(work, list(itertools.pairwise(cuts.tolist())))
        total = parts[0]
        for part in parts[1:]:
            total += part
        return step, np.ascontiguousarray(total.transpose(3, 1, 2, 0)).reshape(cross.shape)


def _group(
    data: Trajectories,
    model: Model,
    keep: NDArray[np.bool_],
    vertices: VertexSystem,
    precision: type[np.floating[Any]],
) -> tuple[NDArray[np.intp], _Groups]:
    """Order (V,) that sorts the vertices by the set of bones that moves them, and the groups."""
    n_bones = model.n_bones
    bones = np.where(model.weights > 0, model.indices, n_bones)
    slot = bones.argsort(axis=1, kind="stable")
    bones = np.take_along_axis(bones, slot, axis=1)
    weights = np.take_along_axis(model.weights, slot, axis=1)
    # two sets with the same code may alternate in the order, which makes more groups but no error
    code = np.zeros(len(bones), dtype=np.uint64)
    for column in bones.T:
        code = code * np.uint64(n_bones + 1) + column.astype(np.uint64)
    order = code.argsort(kind="stable")
    bones, slot = bones[order], slot[order]
    first = np.flatnonzero(np.append(True, (bones[1:] != bones[:-1]).any(axis=1)))
    largest, parts = np.finfo(precision).max, chunk_bounds(len(order), CHUNK)

    def real(x: Array) -> Array:
        out: Array = np.empty(x.shape, dtype=precision)
        # part by part, so that nothing of the size of the whole array is made in between
        run_chunks(lambda _, i, k: np.clip(x[order[i:k]], -largest, largest, out=out[i:k]), parts)
        return out

    return order, _Groups(
        start=np.append(first, len(bones)),
        bones=bones[first],
        sizes=(bones[first] < n_bones).sum(axis=1),
        slot=slot,
        points=real(model.points(vertices.length)),
        weights=real(weights),
        importance=real(data.importance),
        free=~keep[order],
        inverse=real(vertices.inverse),
        gradient=real(vertices.gradient),
    )


def product(left: Array, right: Array) -> Array:
    """Product left @ right, computed in parallel for pieces of its rows."""
    out = np.empty((len(left), right.shape[1]), dtype=left.dtype)
    bounds = chunk_bounds(len(left), max(_PIECE, -(-_MULTIPLICATIONS // max(1, right.size))))
    run_chunks(lambda _, i, k: np.matmul(left[i:k], right, out=out[i:k]), bounds)
    return out


def cross_product(left: Array, right: Array) -> Array:
    """Product leftᵀ @ right, computed in parallel for pieces of its columns, so no sum is split."""
    return product(right.T, left).T
