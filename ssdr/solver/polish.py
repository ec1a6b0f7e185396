"""The polish: Gauss–Newton on the transforms with weights and rest pose projected out.

The objective becomes φ(M) = min over weights and rest pose; one step solves the
Schur complement H_mm + λ·diag − H_mv H_vv⁻¹ H_vm by conjugate gradients, with
products that never touch vertices × frames.

References
----------
Golub and Pereyra, "The differentiation of pseudo-inverses and nonlinear least
squares problems whose variables separate", 1973; Ruhe and Wedin 1980 (the
approximation that drops second derivatives).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..kernels.schur import (
    apply_vertex_step,
    move_bones,
    schur_vertices,
    tangent_image,
    tangent_pullback,
)
from ..parallel import chunk_bounds, run_chunks, serial_blas
from .affine import flat_blocks
from .dense import cross_product, grouped_product, inverse_of, product
from .model import CHUNK, FREE, Fixed, Model
from .moments import bone_sums, transform_sums
from .recycling import Recycled
from .trajectories import Array, Trajectories
from .vertex_newton import newton_vertices

__all__ = ["Polish"]

# at most so many tasks: each holds B×B 4×4 sums of its own (memory), fewer use fewer cores
_TASKS = 8
_TRANSFORMS = 4096  # moved by a task at least: fewer are not worth a thread
_GROUPS = 32  # at most this many factors in the preconditioner
# E(p̃) = Σ_d p̃_d E_d with M E(p̃) the change of M p̃ under (ω, τ): rows of p̃, 3 × 6
_GENERATORS = np.array(
    [
        [[0, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, -1, 0, 0, 0, 0]],
        [[0, 0, -1, 0, 0, 0], [0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]],
        [[0, 1, 0, 0, 0, 0], [-1, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0]],
        [[0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]],
    ],
    dtype=np.float64,
)


@dataclasses.dataclass(eq=False)
class _Eliminated:
    """What the vertex step leaves for the Schur complement."""

    inverse: Array  # (V, D, D) of the vertices' Gauss–Newton matrices
    gradient: Array  # (V, D) half gradients
    hat: Array  # (3F, 4B) transforms
    grouped: _Grouped | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class _Grouped:
    """Vertices ordered by the set of bones that move them, which a group shares.

    One block of the cross products serves a group, and the passes of the
    conjugate gradients read memory from front to back.
    """

    order: NDArray[np.intp]  # (V,)
    start: NDArray[np.intp]  # (G + 1,)
    bones: NDArray[np.intp]  # (G, K) ascending, padded with B
    count: NDArray[np.intp]  # (G,)
    slot: NDArray[np.intp]  # (V, K) of the model's columns, the one of each of the group's bones
    rest: Array
    weights: Array  # (V, K)
    importance: Array
    free: NDArray[np.bool_]
    inverse: Array
    gradient: Array

    @staticmethod
    def build(
        data: Trajectories,
        model: Model,
        left: _Eliminated,
        keep: NDArray[np.bool_],
        precision: type[np.floating[Any]],
    ) -> _Grouped:
        n_bones = model.n_bones
        bones = np.where(model.weights > 0, model.indices, n_bones)
        slot = bones.argsort(axis=1, kind="stable")
        bones = np.take_along_axis(bones, slot, axis=1)
        # Should two sets share a code they only make more groups.
        code = np.zeros(len(bones), dtype=np.uint64)
        for column in bones.T:
            code = code * np.uint64(n_bones + 1) + column.astype(np.uint64)
        order = code.argsort(kind="stable")
        bones, slot = bones[order], slot[order]
        first = np.flatnonzero(np.append(True, (bones[1:] != bones[:-1]).any(axis=1)))
        largest = np.finfo(precision).max

        def real(x: Array) -> Array:
            return x if x.dtype == precision else np.clip(x, -largest, largest).astype(precision)

        return _Grouped(
            order=order,
            start=np.append(first, len(bones)),
            bones=bones[first],
            count=(bones[first] < n_bones).sum(axis=1),
            slot=slot,
            rest=real(model.rest[order]),
            weights=real(np.take_along_axis(model.weights[order], slot, axis=1)),
            importance=real(data.importance[order]),
            free=~keep[order],
            inverse=real(left.inverse[order]),
            gradient=real(left.gradient[order]),
        )


class Polish:
    """Variable-projection steps on one model of rigid bones.

    Parameters
    ----------
    data : Trajectories
    model : Model
        Changed in place by accepted steps only.
    fixed : Fixed
    damping : float, optional
        λ of an earlier polish of this very model, to go on exactly where it
        stopped; by default the vertices are optimised first.
    recycled : Recycled, optional
        Directions of the last step of an earlier polish of this very model.
    conjugate_steps : int
        Most products with the Schur complement a step.
    group : int
        Frames that share a factor in the preconditioner.
    """

    generators = _GENERATORS  # rows of p̃, 3 × the dimension of a tangent
    # of the products with the Schur complement; gradient, residual and preconditioner are double
    precision: type[np.floating[Any]] = np.float32

    def __init__(
        self,
        data: Trajectories,
        model: Model,
        *,
        fixed: Fixed = FREE,
        damping: float | None = None,
        recycled: Recycled | None = None,
        conjugate_steps: int = 12,
        group: int = 24,
    ) -> None:
        self.data, self.model, self.fixed = data, model, fixed
        self.damping = 1e-3 if damping is None else damping
        self.group, self.recycled = group, recycled
        self.conjugate_steps = conjugate_steps
        self._keep = fixed.keep_weights(data.n_vertices)
        self._locked = fixed.locked(model.n_bones)
        frames = max(-(-_TRANSFORMS // model.n_bones), -(-data.n_frames // 16))
        self._frames = chunk_bounds(data.n_frames, frames)
        n = data.n_vertices
        self._vertices = chunk_bounds(n, max(CHUNK, -(-n // _TASKS)))
        # a damping handed over means that the model comes from an earlier polish: only factor it
        first = (3, 2) if damping is None else (-1, 0)
        self._left = self._vertex_step(model, entering=first[0], rounds=first[1])
        self.value = self._judged(model)

    def step(self, *, entering: int = 0) -> bool:
        """One step; True if it was accepted.  The objective never rises."""
        model = self.model
        with serial_blas():
            x, predicted = self._solve()
        trial = dataclasses.replace(
            model,
            transforms=model.transforms.copy(),
            rest=model.rest.copy(),
            indices=model.indices.copy(),
            weights=model.weights.copy(),
            error=model.error.copy(),
        )
        step = self._back_substitute(x)
        self._move(trial.transforms, x)
        move_rest = not self.fixed.rest

        def work(_: int, i: int, k: int) -> None:
            apply_vertex_step(
                step[i:k],
                1.0,
                trial.rest[i:k],
                trial.indices[i:k],
                trial.weights[i:k],
                self._keep[i:k],
                move_rest,
                0,
                k - i,
            )

        run_chunks(work, self._vertices)
        left = self._vertex_step(trial, entering=entering, rounds=2)
        value = self._judged(trial)
        if not value <= self.value:
            self.damping = min(self.damping * 8.0, 1e6)
            return False
        ratio = (self.value - value) / predicted if predicted > 0 else 1.0
        if ratio > 0.7:
            self.damping = max(self.damping / 5.0, 1e-8)
        elif ratio < 0.25:
            self.damping *= 3.0
        for name in ("transforms", "rest", "indices", "weights", "error"):
            setattr(model, name, getattr(trial, name))
        self._left, self.value = left, value
        return True

    def _judged(self, model: Model) -> float:
        return model.objective(self.data)

    def _vertex_step(self, model: Model, *, entering: int, rounds: int) -> _Eliminated:
        data, size = self.data, model.n_influences + 2
        left = _Eliminated(
            inverse=np.empty((data.n_vertices, size, size)),
            gradient=np.empty((data.n_vertices, size)),
            hat=np.empty(0),
        )
        with serial_blas():
            left.hat, gram, gram4, reduced = transform_sums(data, model.transforms)
            newton_vertices(
                lambda i, k: data.z[i:k] @ reduced,
                data.x2,
                (gram, gram4),
                model,
                fixed=self.fixed,
                entering=entering,
                rounds=rounds,
                inverse=left.inverse,
                gradient=left.gradient,
            )
        return left

    def _solve(self) -> tuple[Array, float]:
        """Tangents (F, B, n) of the damped step and the decrease that they promise."""
        data, model = self.data, self.model
        n_bones = model.n_bones
        u, c = bone_sums(data, model.indices, model.weights, model.rest, n_bones)
        scale = data.frame_scale
        hat = self._left.hat
        u_flat = flat_blocks(u)
        _, total = self._eliminate(np.zeros_like(u_flat), 1.0)
        # half gradient of the objective in the stacked transforms: hat·U − C
        slope = product(hat, u_flat - total) - (c * scale[:, None, None, None]).reshape(hat.shape)
        rhs = -self._pullback(slope)
        hat, u_flat = (x.astype(self.precision, copy=False) for x in (hat, u_flat))
        self._add_pull(rhs)
        self._hold(rhs)

        precondition, damp = self._preconditioner(u)
        if self.recycled is not None:
            precondition = self.recycled.around(precondition, rhs.size)

        def apply(x: Array) -> Array:
            image = self._image(x)
            _, total = self._eliminate(cross_product(hat, image), 0.0)
            total = total.astype(self.precision, copy=False)
            out = self._pullback(product(image, u_flat) - product(hat, total))
            out += damp(x)
            self._add_stiffness(x, out)
            self._hold(out)
            return out

        x = np.zeros_like(rhs)
        residual = rhs.copy()
        z = precondition(residual)
        direction = z.copy()
        rho = float(np.vdot(residual, z))
        first, pairs = rho, list[tuple[Array, Array]]()
        for _ in range(self.conjugate_steps):
            if not rho > 1e-10 * first:
                break
            image = apply(direction)
            curvature = float(np.vdot(direction, image))
            if not curvature > 0:
                break
            pairs.append((direction, image))
            alpha = rho / curvature
            x += alpha * direction
            residual -= alpha * image
            z = precondition(residual)
            rho, last = float(np.vdot(residual, z)), rho
            direction = z + (rho / last) * direction
        self.recycled = Recycled.of(pairs) or self.recycled
        # decrease of the undamped quadratic: 2·rhs·x − xᵀAx, with A x = rhs − residual − λDx
        applied = rhs - residual - damp(x)
        return x, float(2.0 * np.vdot(rhs, x) - np.vdot(x, applied))

    def _preconditioner(
        self, u: Array
    ) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
        """Inverses of the Gauss–Newton matrix averaged over groups of frames; damping λ·diag.

        With right tangents the block of two bones depends on the frame by R_jᵀR_k
        alone: frames that follow each other share one factor, and applying it is a
        matrix product.
        """
        model, data = self.model, self.data
        n_frames, n_bones = model.transforms.shape[:2]
        frame_weight = data.frame_scale**2
        generators = self.generators
        n_tangent = generators.shape[2]
        size = n_tangent * n_bones
        index = np.arange(n_bones)
        own = np.einsum("dca,jde,ecb->jab", generators, u[index, index], generators)
        own = np.maximum(np.einsum("jaa->ja", own), 1e-300)
        own = np.maximum(own, 1e-12 * own.max())
        groups = chunk_bounds(n_frames, max(self.group, -(-n_frames // _GROUPS)))
        rotation = np.ascontiguousarray(model.transforms[..., :3])
        table = u.transpose(2, 3, 0, 1).reshape(1, 16, -1)
        # of the products of turn[c, f] and table[d, e]
        signs = np.einsum("dca,efb->abcfde", generators, generators).reshape(n_tangent**2, 144)

        def invert(_: int, i: int, k: int) -> Array:
            stack = rotation[i:k].transpose(0, 2, 3, 1).reshape(3 * (k - i), 3 * n_bones)
            turn = (stack.T @ stack).reshape(3, n_bones, 3, n_bones) / (k - i)
            turn = turn.transpose(0, 2, 1, 3).reshape(9, 1, -1)
            mean = signs @ (turn * table).reshape(144, -1)
            mean = mean.reshape(n_tangent, n_tangent, n_bones, n_bones)
            matrix = np.ascontiguousarray(mean.transpose(2, 0, 3, 1)).reshape(size, size)
            matrix[np.diag_indices(size)] += (self.damping + 1e-9) * own.ravel()
            return inverse_of(matrix)

        inverses = run_chunks(invert, groups)

        def precondition(r: Array) -> Array:
            flat = r.reshape(n_frames, size) / frame_weight[:, None]
            out = grouped_product(flat, groups, inverses).reshape(r.shape)
            out[:, self._locked] = 0.0  # the search stays among the bones that may move
            return out

        damped = self.damping * (frame_weight[:, None, None] * own)
        return precondition, lambda x: damped * x

    def _hold(self, x: Array) -> None:
        x[:, self._locked] = 0.0

    def _add_pull(self, rhs: Array) -> None:
        """Add what lowers the objective beside the error; nothing here."""

    def _add_stiffness(self, x: Array, out: Array) -> None:
        """Add its second derivative times x."""

    def _move(self, transforms: Array, x: Array) -> None:
        run_chunks(
            lambda _, i, k: move_bones(transforms[i:k], x[i:k], self._locked, 0, k - i),
            self._frames,
        )

    def _image(self, x: Array) -> Array:
        n_frames, n_bones = x.shape[:2]
        m, scale = self.model.transforms, self.data.frame_scale
        out = np.empty((3 * n_frames, 4, n_bones), dtype=self.precision)
        run_chunks(lambda _, i, k: tangent_image(m, x, scale, out, i, k), self._frames)
        return out.reshape(3 * n_frames, 4 * n_bones)

    def _pullback(self, g: Array) -> Array:
        m, scale = self.model.transforms, self.data.frame_scale
        n_frames, n_bones = m.shape[:2]
        out = np.empty((n_frames, n_bones, 6))
        g = np.ascontiguousarray(g).reshape(3 * n_frames, 4, n_bones)
        run_chunks(lambda _, i, k: tangent_pullback(m, g, scale, out, i, k), self._frames)
        return out

    def _eliminate(self, cross: Array, share: float) -> tuple[Array, Array]:
        """What the vertices answer to a change of the transforms, and its image.

        `cross` is hatᵀ times the change of the stacked transforms, (4B, 4B), and so is the image;
        the answer (V, D) is in the order of the groups.
        """
        model, left = self.model, self._left
        n_bones = model.n_bones
        if left.grouped is None:
            left.grouped = _Grouped.build(self.data, model, left, self._keep, self.precision)
        own = left.grouped
        step = np.empty((len(own.order), model.n_influences + 2), dtype=self.precision)
        move_rest = not self.fixed.rest
        table = np.ascontiguousarray(
            cross.reshape(4, n_bones, 4, n_bones).transpose(3, 1, 2, 0), dtype=self.precision
        )

        def work(_: int, i: int, k: int) -> Array:
            total = np.zeros((n_bones, n_bones, 4, 4))
            schur_vertices(
                table,
                own.start,
                own.bones,
                own.count,
                own.slot,
                own.rest,
                own.weights,
                own.importance,
                own.free,
                own.inverse,
                own.gradient,
                share,
                step,
                total,
                move_rest,
                i,
                k,
            )
            return total

        cuts = np.searchsorted(own.start, [0, *(k for _, k in self._vertices)])
        parts = run_chunks(work, list(itertools.pairwise(cuts.tolist())))
        total = parts[0]
        for part in parts[1:]:
            total += part
        return step, np.ascontiguousarray(total.transpose(3, 1, 2, 0)).reshape(cross.shape)

    def _back_substitute(self, x: Array) -> Array:
        with serial_blas():
            image = self._image(x)
            hat = self._left.hat.astype(self.precision, copy=False)
            grouped, _ = self._eliminate(cross_product(hat, image), 1.0)
        assert self._left.grouped is not None
        step = np.empty(grouped.shape)
        step[self._left.grouped.order] = grouped
        return step
