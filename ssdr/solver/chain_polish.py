"""The polish of bones that hang on joints: rotations, roots and joints in place of transforms."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from ..hierarchy.tree import Tree
from ..kernels.chains import chain_image, chain_matrix, chain_move, chain_pullback
from ..parallel import chunk_bounds, run_chunks
from .dense import inverse_of
from .model import FREE, Model
from .polish import Polish
from .skin_contact import PULL, judged, spread, strays
from .trajectories import Array, Trajectories

__all__ = ["ChainPolish"]

_GROUP = 12  # frames that share a factor of the preconditioner, at least
_MEMORY = 64 << 20  # bytes of these factors, at most, unless they are few
_FEW = 8
_DAMPED = 1e-9  # of the diagonal, so that what nothing determines stays put
_ROUNDING = 1e-12
# Products with the Schur complement a step, at most: what a joint turns moves all that hangs on
# it, and with as few as for free bones exact data takes twice the steps.
_CONJUGATE_STEPS = 30
_LEAST = 1e-12, 1e-9  # of the largest diagonal entry: of rotations and roots, and of joints


class ChainPolish(Polish):
    """Variable-projection steps on local rotations, root translations and joint positions.

    A vector of unknowns holds, frame by frame, ω of every bone in its own axes and τ of every
    root, then δc of every joint, which all frames share.  The preconditioner eliminates the
    frames' unknowns exactly from the Gauss–Newton matrix under fixed weights and rest pose,
    averaged over groups of frames.

    The model's bones must hang on their joints.
    """

    precision = np.float64  # long chains need it

    def __init__(self, data: Trajectories, model: Model, **options: Any) -> None:
        tree = model.tree
        assert tree is not None
        assert tree.rigid
        self.parents, self.order = tree.parents, tree.order
        self.roots = tree.roots
        kept = options.get("fixed", FREE).joints
        self.movable = tree.hung[:0] if kept else tree.hung  # bones whose joints are unknowns
        self._moved = tree.points
        self._spring = np.zeros((len(self.movable), 1))
        self._away = np.zeros((len(self.movable), 3))
        # bones whose ω follows from their parent's, with their rotation relative to it
        self._tied = options.get("fixed", FREE).kept_turns(tree)
        super().__init__(data, model, **({"conjugate_steps": _CONJUGATE_STEPS} | options))

    @property
    def points(self) -> Array:
        return self._tree.points

    def step(self, *, entering: int = 0) -> bool:
        accepted = super().step(entering=entering)
        if accepted:
            self.model.tree = dataclasses.replace(self._tree, points=self._moved)
        return accepted

    def _judged(self, model: Model) -> float:
        tree = dataclasses.replace(self._tree, points=self._moved)
        return judged(self.data, dataclasses.replace(model, tree=tree), self.fixed)

    @property
    def _tree(self) -> Tree:
        assert self.model.tree is not None
        return self.model.tree

    # --- joints that are drawn to the skin -------------------------------------------------------

    def _solve(self) -> tuple[Array, float]:
        if not self.fixed.near_skin or not len(self.movable):
            return super()._solve()
        off, squared = strays(self.model)
        factor = 1.0 + PULL * spread(squared[self._tree.hung])
        # of the objective over this factor: the error, and a spring for every joint
        spring = PULL * self.model.objective(self.data) / (len(self._tree.hung) * factor)
        self._spring = spring * (1.0 + 2.0 * squared[self.movable, None])
        self._away = off[self.movable]
        x, predicted = super()._solve()
        return x, factor * predicted

    def _add_pull(self, rhs: Array) -> None:
        self._parts(rhs)[1][:] -= self._spring * self._away

    def _add_stiffness(self, x: Array, out: Array) -> None:
        self._parts(out)[1][:] += self._spring * self._parts(x)[1]

    # --- vectors of unknowns ---------------------------------------------------------------------

    def _parts(self, x: Array) -> tuple[Array, Array]:
        """Views of the unknowns of the frames (F, 3B + 3R) and of the joints that may move."""
        n_frames, n_bones = self.model.transforms.shape[:2]
        size = 3 * (n_bones + len(self.roots))
        return x[: n_frames * size].reshape(n_frames, size), x[n_frames * size :].reshape(-1, 3)

    def _zeros(self) -> Array:
        n_frames, n_bones = self.model.transforms.shape[:2]
        return np.zeros(3 * (n_frames * (n_bones + len(self.roots)) + len(self.movable)))

    def _unpacked(self, x: Array) -> tuple[Array, Array, Array]:
        """ω (F, B, 3), τ (F, B, 3) and δc (B, 3) of a vector."""
        n_frames, n_bones = self.model.transforms.shape[:2]
        frames, joints = self._parts(x)
        turns = np.ascontiguousarray(frames[:, : 3 * n_bones]).reshape(n_frames, n_bones, 3)
        shifts, moved = np.zeros((n_frames, n_bones, 3)), np.zeros((n_bones, 3))
        shifts[:, self.roots] = frames[:, 3 * n_bones :].reshape(n_frames, -1, 3)
        moved[self.movable] = joints
        for j, k, turn in self._tied:
            turns[:, j] = np.einsum("tba,tb->ta", turn, turns[:, k])
        return turns, shifts, moved

    def _hold(self, x: Array) -> None:
        """Nothing is locked."""

    def _image(self, x: Array) -> Array:
        m = self.model.transforms
        out = np.empty((*m.shape[:2], 6))
        turns, shifts, moved = self._unpacked(x)
        chain_image(m, self.order, self.parents, self.points, turns, shifts, moved, out, 0, len(m))
        return super()._image(out)

    def _pullback(self, g: Array) -> Array:
        m = self.model.transforms
        n_frames, n_bones = m.shape[:2]
        turns, shifts = np.empty((n_frames, n_bones, 3)), np.empty((n_frames, n_bones, 3))
        moved, tangents = np.zeros((n_bones, 3)), super()._pullback(g)
        chain_pullback(
            m, self.order, self.parents, self.points, tangents, turns, shifts, moved, 0, n_frames
        )
        for j, k, turn in self._tied[::-1]:
            turns[:, k] += np.einsum("tba,ta->tb", turn, turns[:, j])
            turns[:, j] = 0.0
        out = self._zeros()
        frames, joints = self._parts(out)
        frames[:, : 3 * n_bones] = turns.reshape(n_frames, -1)
        frames[:, 3 * n_bones :] = shifts[:, self.roots].reshape(n_frames, -1)
        joints[:] = moved[self.movable]
        return out

    def _move(self, transforms: Array, x: Array) -> None:
        turns, shifts, moved = self._unpacked(x)
        self._moved = self.points + moved

        def work(_: int, i: int, k: int) -> None:
            chain_move(
                transforms[i:k],
                self.order,
                self.parents,
                self._moved,
                turns[i:k],
                shifts[i:k],
                0,
                k - i,
            )

        run_chunks(work, self._frames)

    # --- the preconditioner ----------------------------------------------------------------------

    def _preconditioner(
        self, u: Array
    ) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
        model = self.model
        n_frames, n_bones = model.transforms.shape[:2]
        weight = self.data.frame_scale**2
        most = max(_FEW, _MEMORY // (8 * (6 * n_bones) ** 2))
        groups = chunk_bounds(n_frames, max(_GROUP, -(-n_frames // most)))
        slot = np.arange(6 * n_bones).reshape(n_bones, 6)
        inner = np.concatenate([slot[:, :3].ravel(), slot[self.roots, 3:].ravel()])
        outer = slot[self.movable, 3:].ravel()
        tied = np.array([3 * j + d for j, _, _ in self._tied for d in range(3)], dtype=np.intp)
        size = 6 * n_bones

        def matrix(_: int, i: int, k: int) -> Array:
            out = np.zeros((n_bones, 6, n_bones, 6))
            chain_matrix(
                model.transforms, self.order, self.parents, self.points, u, weight, out, i, k
            )
            return out.reshape(size, size)

        matrices = run_chunks(matrix, groups)
        diagonal = np.sum([m.diagonal() for m in matrices], axis=0)
        own, own_joints = (
            np.maximum(d, max(least * float(d.max(initial=0.0)), 1e-300))
            for d, least in zip((diagonal[inner] / n_frames, diagonal[outer]), _LEAST, strict=True)
        )
        damping = self.damping + _DAMPED
        # joints along which nothing moves: what elimination leaves of them is rounding
        open_ways = _ROUNDING * n_frames * float(own.max())

        def factor(g: int, _i: int, _k: int) -> tuple[Array, Array, Array]:
            count, full = groups[g][1] - groups[g][0], matrices[g]
            block = full[np.ix_(inner, inner)] / count
            block[np.diag_indices(len(inner))] += damping * own
            side = full[np.ix_(inner, outer)] / count
            block[tied], block[:, tied], side[tied] = 0.0, 0.0, 0.0
            block[tied, tied] = own[tied]
            inverse = inverse_of(block)
            answer = inverse @ side
            left = full[np.ix_(outer, outer)] - count * (side.T @ answer)
            return inverse, answer, left

        factors = run_chunks(factor, chunk_bounds(len(groups), 1))
        schur = np.sum([left for _, _, left in factors], axis=0)
        schur[np.diag_indices(len(outer))] += damping * own_joints + open_ways
        schur[np.diag_indices(len(outer))] += np.repeat(self._spring, 3)
        lower = cho_factor(schur, lower=True) if len(outer) else None

        def precondition(r: Array) -> Array:
            out = np.empty_like(r)
            (frames, joints), (to_frames, to_joints) = self._parts(r), self._parts(out)
            right = joints.ravel().copy()
            for (i, k), (inverse, answer, _) in zip(groups, factors, strict=True):
                to_frames[i:k] = frames[i:k] @ inverse
                right -= frames[i:k].sum(axis=0) @ answer
            if lower is not None:
                moved = cho_solve(lower, right)
                to_joints[:] = moved.reshape(-1, 3)
                for (i, k), (_, answer, _) in zip(groups, factors, strict=True):
                    to_frames[i:k] -= answer @ moved
            return out

        def damp(x: Array) -> Array:
            out = np.empty_like(x)
            (frames, joints), (to_frames, to_joints) = self._parts(x), self._parts(out)
            to_frames[:] = frames * (self.damping * own)
            to_joints[:] = joints * (self.damping * own_joints.reshape(-1, 3))
            return out

        return precondition, damp
