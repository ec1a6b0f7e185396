"""Normal equations of the bones with weights and rest pose eliminated, as a Schur complement.

H_vv consists of one small block for each vertex, whose inverse the vertex step returns, and of λL
on the rest positions, where L is the Laplacian of the edges of the surface.  The inverses have a
bound of λL in it that is a term of each vertex alone.  Here λL itself takes the bound's place, as
the bound holds a patch where it is, though only the edges on its rim resist a motion with its bone.
So vertices answer under the bound first; then conjugate gradients solve (A + λL) δp = b for all
rest positions, where A has the blocks (3×3) with weights and normals eliminated; these follow.

The system that remains for the stacked transforms m has the matrix H_mm − H_mv H_vv⁻¹ H_vm.  A
product with it takes sums over frames (4B, 4B), then sums over vertices, but never an array of
vertices × frames.

References
----------
Triggs et al., "Bundle adjustment: a modern synthesis", 2000, section 6.1 (the same structure
without edges).
"""

from __future__ import annotations

import functools
import itertools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..common.parallel import chunk_bounds, run_chunks
from ..kernels.coupling import add_patches, begin_coupling, couple_vertices
from ..kernels.schur import answer_bones, apply_vertex_step, effect_on_bones
from .model import CHUNK, Constraints, Model
from .moments import bone_sums, stack_blocks
from .trajectories import Array, Trajectories
from .vertex_newton import VertexSystem

Mask = NDArray[np.bool_]
Precision = type[np.floating[Any]]

# Fewest rows and multiplications of a piece: small products are slow, and handing them to threads
# costs more than it saves.
_PIECE, _MULTIPLICATIONS = 96, 2_000_000

# most tasks: each needs memory for its own (B, B, 4, 4) sums, but fewer tasks would use fewer cores
_TASKS = 8

# Most iterations of a solve of the rest positions together, and the relative residual that ends it:
# in a product, and in a step or gradient.  What bones and rest pose do together costs thousands of
# times less than either alone, so that with 4 iterations the difference has no digits left.
_ROUGH, _ACCURATE = (12, 1e-4), (20, 1e-4)


class _Groups(NamedTuple):
    """Vertices grouped by the bones that move them, as arrays for kernels.

    :func:`answer_bones` takes all but the last field, :func:`effect_on_bones` all but `gradient`.
    """

    start: NDArray[np.intp]  # (G + 1,) first vertex of each group
    bones: NDArray[np.intp]  # (G, K) bones of each group, ascending, padded with B
    sizes: NDArray[np.intp]  # (G,) number of bones of each group
    slot: NDArray[np.intp]  # (V, K) column of each of the group's bones in the model's weights
    points: Array
    weights: Array  # (V, K) in the order of the group's bones
    free: NDArray[np.bool_]
    inverse: Array
    gradient: Array
    importance: Array


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
        self.move_rest = not constraints.lock_rest
        self.keep = constraints.vertex_mask(data.n_vertices)
        n = data.n_vertices
        self._tasks = chunk_bounds(n, max(CHUNK, -(-n // _TASKS)))
        self._order, self._groups = _group(data, model, self.keep, vertices, precision)
        self._coupling = _couple(data, model, self.keep, vertices, precision)
        self.length = vertices.length
        self.u, c = bone_sums(data, model, length=self.length)
        stacked, u = vertices.stacked, stack_blocks(self.u)
        self._axes = stacked.reshape(-1, 4, self.n_bones)[:, :3].transpose(1, 2, 0)
        self._squares = np.einsum("aju,bju->jab", self._axes, self._axes)
        self._given = data, model, constraints, vertices.strength
        c *= data.frame_scale[:, None, None, None]
        _, answer = self._eliminate(np.zeros_like(u), 1.0)
        self.gradient = product(stacked, u - answer) - c.reshape(stacked.shape)
        self.stacked, self.u_flat = (x.astype(precision, copy=False) for x in (stacked, u))

    @functools.cached_property
    def patches(self) -> Array | None:
        """Cost (B, B, 4, 4) of changes of the bones that are the same in all frames.

        If every transform M_j is multiplied by the same 1 + X_j (3×4) in all frames and the rest
        pose follows with −Σ_j w_j X_j p̃, the squared error and the term of the edges rise by
        about Σ_jk tr(X_j patches_jk X_kᵀ): R_jᵀR_k is replaced by a third of its trace, and weights
        stay.  None if the rest pose is locked or bones have joints, and for bones that stretch if
        no edge holds it: there a step with `patches` ends a polish early.
        """
        data, model, constraints, strength = self._given
        free = self.move_rest and constraints.bone_model == "rigid"
        if model.tree is not None or not (free or self._coupling is not None):
            return None
        n, surface = data.n_vertices, data.surface
        turns = (self._axes @ self._axes.transpose(0, 2, 1)).sum(axis=0) / 3
        skin = model.points(self.length), model.indices, model.weights, data.importance, turns
        rows: Any = np.zeros(n), np.zeros(n + 1, dtype=np.int64), np.zeros(0, dtype=np.uint32)
        rows = *rows, np.zeros(0)
        if surface is not None:
            rows = strength * surface.degree, *surface.rows(strength)

        def work(_: int, i: int, k: int) -> Array:
            total = np.zeros_like(self.u)
            arrays: Any = *skin, *rows, i, k, total
            add_patches(*arrays)
            return total

        total: Array = np.sum(run_chunks(work, self._tasks), axis=0)
        return np.asarray(total + total.transpose(1, 0, 3, 2) + turns[:, :, None, None] * self.u)

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
        move_rest = self.move_rest
        cuts = np.searchsorted(groups.start, [0, *(k for _, k in self._tasks)])
        tasks = list(itertools.pairwise(cuts.tolist()))
        run_chunks(
            lambda _, i, k: answer_bones(table, *groups[:-1], share, step, move_rest, i, k), tasks
        )
        change = np.empty((0, 3), dtype=step.dtype)
        if self._coupling is not None:
            change = np.empty((len(step), 3), dtype=step.dtype)
            accuracy = _ACCURATE if share else _ROUGH
            # rest positions that follow what the bones do in all frames are the first guess
            same = np.einsum("djej->jde", cross.reshape(4, n_bones, 4, n_bones)[:3])
            moves = np.linalg.solve(self._squares, same)
            skin: Any = moves.astype(step.dtype), *groups[:3], groups.points, groups.weights
            arrays: Any = step, *skin, self._order, *self._coupling, *accuracy, change
            couple_vertices(*arrays)

        def work(_: int, i: int, k: int) -> Array:
            total = np.zeros((n_bones, n_bones, 4, 4))
            effect_on_bones(*groups[:-2], groups.importance, change, step, total, move_rest, i, k)
            return total

        parts = run_chunks(work, tasks)
        total = parts[0]
        for part in parts[1:]:
            total += part
        return step, np.ascontiguousarray(total.transpose(3, 1, 2, 0)).reshape(cross.shape)


def _group(
    data: Trajectories, model: Model, keep: Mask, vertices: VertexSystem, precision: Precision
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
        free=~keep[order],
        inverse=real(vertices.inverse),
        gradient=real(vertices.gradient),
        importance=real(data.importance),
    )


def _couple(
    data: Trajectories, model: Model, keep: Mask, vertices: VertexSystem, precision: Precision
) -> tuple[Any, ...] | None:
    """Arguments of :func:`couple_vertices` that stay, from `column` to `edges`.

    None if no edge holds the rest pose.
    """
    surface, strength = data.surface, vertices.strength
    if surface is None or not strength > 0:
        return None
    n = len(keep)
    column = np.where(keep, 0, np.count_nonzero(model.weights, axis=1) - 1)
    hold, diagonal = surface.stiffness(strength, data.importance), strength * surface.degree
    blocks = np.empty((3, 3, 3, n), dtype=precision)
    begin_coupling(vertices.inverse, column, data.importance, hold, diagonal, *blocks)
    start, ends, edges = surface.rows(strength)
    shift = data.importance * hold - diagonal
    return column, *blocks, shift.astype(precision), start, ends, edges.astype(precision)


def product(left: Array, right: Array) -> Array:
    """Product left @ right, computed in parallel for pieces of its rows."""
    out = np.empty((len(left), right.shape[1]), dtype=left.dtype)
    bounds = chunk_bounds(len(left), max(_PIECE, -(-_MULTIPLICATIONS // max(1, right.size))))
    run_chunks(lambda _, i, k: np.matmul(left[i:k], right, out=out[i:k]), bounds)
    return out


def cross_product(left: Array, right: Array) -> Array:
    """Product leftᵀ @ right, computed in parallel for pieces of its columns, so no sum is split."""
    return product(right.T, left).T
