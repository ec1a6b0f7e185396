"""Unknowns of bones of a tree with rigid joints: rotations, root translations and joints."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ...common.parallel import chunk_bounds, run_chunks
from ...kernels.chains import chain_image, chain_matrix, chain_move, chain_pullback
from ..conjugate_gradients import Operator
from ..model import FREE, Constraints, Model
from ..objective import JointPenalty
from ..trajectories import Array, Trajectories
from .tangent import RigidTangent, Tangent, inverse_of

_GROUP = 12  # fewest frames that share a factor of the preconditioner
_MEMORY = 64 << 20  # most bytes of all factors
_FEW = 8  # number of factors that is allowed whatever memory it takes
_DAMPED = 1e-9  # damping, relative to the diagonal, of unknowns that nothing else determines
_ROUNDING = 1e-12  # relative addition to the joints' diagonal that covers rounding
# Smallest entries of the damping's diagonal, relative to the largest: of frames, and of joints.
_LEAST = 1e-12, 1e-9


class ChainTangent(Tangent):
    """Unknowns x: for each frame ω of all bones and τ of all roots, then δc of all joints.

    ω is a rotation and τ a translation, both in the bone's own axes; δc is a change of the joint in
    the rest pose, the same for all frames.  All bones except roots are translated so that their
    joints stay connected.  The model's tree must be rigid.
    """

    conjugate_steps = 30  # more than for free bones, since a joint moves its whole subtree

    def __init__(self, data: Trajectories, model: Model, constraints: Constraints = FREE) -> None:
        super().__init__(data, model)
        self._bones = RigidTangent(data, model)
        self._bones.precision = self.precision  # long chains need it
        tree = model.hierarchy
        assert tree.rigid
        self._parents, self._order, self._roots = tree.parents, tree.order, tree.roots
        self.joints = tree.non_roots[:0] if constraints.lock_joints else tree.non_roots
        self.penalty = JointPenalty.none(len(self.joints))

    def image(self, x: Array) -> Array:
        m = self.model.transforms
        tangents = np.empty((*m.shape[:2], 6))
        chain_image(m, *self._chain(), *self._unpacked(x), tangents)
        return self._bones.image(tangents)

    def pullback(self, gradient: Array) -> Array:
        m = self.model.transforms
        n_frames, n_bones = m.shape[:2]
        turns, shifts = np.empty((n_frames, n_bones, 3)), np.empty((n_frames, n_bones, 3))
        moved, tangents = np.zeros((n_bones, 3)), self._bones.pullback(gradient)
        chain_pullback(m, *self._chain(), tangents, turns, shifts, moved)
        out = self.zeros()
        frames, joints = self.parts(out)
        frames[:, : 3 * n_bones] = turns.reshape(n_frames, -1)
        frames[:, 3 * n_bones :] = shifts[:, self._roots].reshape(n_frames, -1)
        joints[:] = moved[self.joints]
        return out

    def move(self, model: Model, x: Array) -> None:
        """Move joints, rotate every bone by exp(ω), and translate it onto its joint (in place)."""
        turns, shifts, moved = self._unpacked(x)
        tree = self.model.hierarchy
        m, points = model.transforms, tree.points + moved
        model.tree = dataclasses.replace(tree, points=points)

        def work(_: int, i: int, k: int) -> None:
            chain_move(m[i:k], self._order, self._parents, points, turns[i:k], shifts[i:k])

        run_chunks(work, self.chunks)

    def precondition(
        self, u: Array, damping: float, patches: Array | None = None
    ) -> tuple[Operator, Operator]:
        """The inverse of H + λD, with H averaged over groups of frames, and λD.

        The unknowns of the frames are eliminated exactly; the Schur complement of the joints is
        summed over all frames.
        """
        m = self.model.transforms
        n_frames, n_bones = m.shape[:2]
        weight, size = self.data.frame_scale**2, 6 * n_bones
        most = max(_FEW, _MEMORY // (8 * size**2))
        groups = chunk_bounds(n_frames, max(_GROUP, -(-n_frames // most)))
        slot = np.arange(size).reshape(n_bones, 6)
        inner = np.concatenate([slot[:, :3].ravel(), slot[self._roots, 3:].ravel()])
        outer = slot[self.joints, 3:].ravel()

        def matrix(_: int, i: int, k: int) -> Array:
            out = np.zeros((n_bones, 6, n_bones, 6))
            chain_matrix(m[i:k], *self._chain(), u, weight[i:k], out)
            return out.reshape(size, size)

        matrices = run_chunks(matrix, groups)
        diagonal = np.sum([m.diagonal() for m in matrices], axis=0)
        own, own_joints = (
            np.maximum(d, max(least * float(d.max(initial=0.0)), 1e-300))
            for d, least in zip((diagonal[inner] / n_frames, diagonal[outer]), _LEAST, strict=True)
        )
        damped = damping + _DAMPED

        def factor(g: int, _i: int, _k: int) -> tuple[Array, Array, Array]:
            count, full = groups[g][1] - groups[g][0], matrices[g]
            block = full[np.ix_(inner, inner)] / count
            block[np.diag_indices(len(inner))] += damped * own
            side = full[np.ix_(inner, outer)] / count
            inverse = inverse_of(block)
            answer = inverse @ side
            left = full[np.ix_(outer, outer)] - count * (side.T @ answer)
            return inverse, answer, left

        factors = run_chunks(factor, chunk_bounds(len(groups), 1))
        schur = np.sum([left for _, _, left in factors], axis=0)
        # where moving a joint moves nothing, elimination leaves rounding
        schur[np.diag_indices(len(outer))] += damped * own_joints + _ROUNDING * n_frames * float(
            own.max()
        )
        schur[np.diag_indices(len(outer))] += np.repeat(self.penalty.stiffness, 3)
        lower = cho_factor(schur, lower=True) if len(outer) else None

        def precondition(r: Array) -> Array:
            out = np.empty_like(r)
            (frames, joints), (to_frames, to_joints) = self.parts(r), self.parts(out)
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

        scale = self.zeros()
        of_frames, of_joints = self.parts(scale)
        of_frames[:], of_joints[:] = damping * own, damping * own_joints.reshape(-1, 3)
        return precondition, lambda x: scale * x

    def joint_part(self, x: Array) -> Array:
        return self.parts(x)[1]

    def parts(self, x: Array) -> tuple[Array, Array]:
        """Split x into two views: the unknowns of the frames, and those of the joints.

        The first is (F, 3B + 3R) for B bones and R roots; the second, (J, 3), are the changes δc of
        the J joints that may move.
        """
        n_frames, n_bones = self.model.transforms.shape[:2]
        size = 3 * (n_bones + len(self._roots))
        return x[: n_frames * size].reshape(n_frames, size), x[n_frames * size :].reshape(-1, 3)

    def zeros(self) -> Array:
        """Unknowns x = 0, which move nothing."""
        n_frames, n_bones = self.model.transforms.shape[:2]
        return np.zeros(3 * (n_frames * (n_bones + len(self._roots)) + len(self.joints)))

    def _unpacked(self, x: Array) -> tuple[Array, Array, Array]:
        """Split x into ω (F, B, 3), τ (F, B, 3) and δc (B, 3), with 0 where there is no unknown."""
        n_frames, n_bones = self.model.transforms.shape[:2]
        frames, joints = self.parts(x)
        turns = np.ascontiguousarray(frames[:, : 3 * n_bones]).reshape(n_frames, n_bones, 3)
        shifts, moved = np.zeros((n_frames, n_bones, 3)), np.zeros((n_bones, 3))
        shifts[:, self._roots] = frames[:, 3 * n_bones :].reshape(n_frames, -1, 3)
        moved[self.joints] = joints
        return turns, shifts, moved

    def _chain(self) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """First arguments of the kernels: an order of the bones, their parents, and their joints.

        Parents precede children in the order.  Joints (B, 3) are in the rest pose.
        """
        return self._order, self._parents, self.model.hierarchy.points
