"""Base class of the unknowns by which a Gauss–Newton step moves the bones."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from ...common.parallel import chunk_bounds, run_chunks
from ...kernels.bones import LARGEST, SMALLEST
from ...kernels.schur import move_bones, tangent_image, tangent_pullback
from ..affine_fit import admissible, ridge_blocks, stack_diagonal
from ..conjugate_gradients import Operator
from ..model import Model
from ..moments import stack_blocks
from ..objective import JointPenalty
from ..trajectories import Array, Trajectories, stack_transforms, unstack_transforms

_TRANSFORMS = 4096  # fewest transforms of a task: fewer are not worth a thread


class Tangent(ABC):
    """Unknowns x of a step that moves the bones of a model.

    :meth:`image` is the first-order change of the transforms under x, :meth:`move` the step itself.

    Parameters
    ----------
    data : Trajectories
    model : Model
        Methods read the transforms that it has when they are called.

    Attributes
    ----------
    precision : type
        Data type of images and of products with the Schur complement.
    conjugate_steps : int
        Largest number of products with the Schur complement in a step.
    joints : (J,) int array
        Indices of the bones whose joints are unknowns, too.
    penalty : JointPenalty
        Penalty on these joints at the present model.
    """

    precision: type[np.floating[Any]] = np.float64
    conjugate_steps = 12
    joints: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
    penalty: JointPenalty = JointPenalty.none(0)

    def __init__(self, data: Trajectories, model: Model) -> None:
        self.data, self.model = data, model
        frames = max(-(-_TRANSFORMS // model.n_bones), -(-data.n_frames // 16))
        self.chunks = chunk_bounds(data.n_frames, frames)

    @abstractmethod
    def image(self, x: Array) -> Array:
        """First-order change (3F, 4B) of the stacked transforms under x."""

    @abstractmethod
    def pullback(self, gradient: Array) -> Array:
        """Gradient with respect to x, from that (3F, 4B) with respect to the stacked transforms.

        This is the transpose of :meth:`image`.
        """

    @abstractmethod
    def move(self, model: Model, x: Array) -> None:
        """Move the bones of `model`, a copy of this model, by the step x (in place)."""

    @abstractmethod
    def precondition(
        self, u: Array, damping: float, patches: Array | None = None
    ) -> tuple[Operator, Operator]:
        """An approximate inverse of H + λD, and λD, both as operators, with λ = `damping`.

        H is the Gauss–Newton matrix of the unknowns x for fixed weights and rest pose, and D the
        scale of its diagonal.  `u` (B, B, 4, 4) is Σ_i w_j w_k p̃ p̃ᵀ for bones j and k, and
        `patches` that of :class:`~ssdr.solver.vertex_elimination.ReducedSystem`.  With it, the
        inverse of the small matrix of changes that are the same in all frames is added: if the rest
        pose can follow these, they cost far less than H says (a two-level method, as of Nicolaides
        1987, with a space for each bone).
        """

    def joint_part(self, x: Array) -> Array:
        """View (J, 3) of the unknowns in x that move joints."""
        return x.reshape(-1)[:0].reshape(0, 3)


def inverse_of(matrix: Array) -> Array:
    """Exactly symmetric inverse of a positive definite matrix, by Cholesky factorisation.

    This takes half the operations of a general inverse.  If rounding has made the matrix
    indefinite, the general inverse is used.
    """
    factor, failed = lapack.dpotrf(matrix, lower=1)
    if not failed:
        inverse, failed = lapack.dpotri(factor, lower=1)
    if failed:
        inverse = np.linalg.inv(matrix)
    lower = np.tril(inverse)
    return np.asarray(lower + np.tril(inverse, -1).T)


# Matrices E_d (3, 6), d = 1 to 4.  With E(p̃) = Σ_d p̃_d E_d, unknowns (ω, τ) change M p̃ by
# M E(p̃) (ω, τ).
GENERATORS = np.array(
    [
        [[0, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, -1, 0, 0, 0, 0]],
        [[0, 0, -1, 0, 0, 0], [0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]],
        [[0, 1, 0, 0, 0, 0], [-1, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0]],
        [[0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 1]],
    ],
    dtype=np.float64,
)
_GROUP = 24  # fewest frames that share a factor of the preconditioner
_GROUPS = 32  # most factors
# Least damping of what is the same in all frames: to move everything so costs nothing.
_SAME = 1e-4


class RigidTangent(Tangent):
    """Unknowns x (F, B, 6): (ω, τ) of each bone, which change M by δM = M [[ω]× τ; 0 0].

    A subclass with other constant `generators` is possible for transforms that such a change does
    not lead out of; others need a :class:`Tangent` of their own.
    """

    precision: type[np.floating[Any]] = np.float32
    generators = GENERATORS  # (4, 3, n) for the n unknowns of a bone

    def image(self, x: Array) -> Array:
        n_frames, n_bones = x.shape[:2]
        m, scale = self.model.transforms, self.data.frame_scale
        out = np.empty((3 * n_frames, 4, n_bones), dtype=self.precision)
        run_chunks(
            lambda _, i, k: tangent_image(m[i:k], x[i:k], scale[i:k], out[3 * i : 3 * k]),
            self.chunks,
        )
        return out.reshape(3 * n_frames, 4 * n_bones)

    def pullback(self, gradient: Array) -> Array:
        m, scale = self.model.transforms, self.data.frame_scale
        n_frames, n_bones = m.shape[:2]
        out = np.empty((n_frames, n_bones, 6))
        g = np.ascontiguousarray(gradient).reshape(3 * n_frames, 4, n_bones)
        run_chunks(
            lambda _, i, k: tangent_pullback(m[i:k], g[3 * i : 3 * k], scale[i:k], out[i:k]),
            self.chunks,
        )
        return out

    def move(self, model: Model, x: Array) -> None:
        """Replace M by M exp(x) (in place)."""
        m = model.transforms
        run_chunks(lambda _, i, k: move_bones(m[i:k], x[i:k]), self.chunks)

    def precondition(
        self, u: Array, damping: float, patches: Array | None = None
    ) -> tuple[Operator, Operator]:
        """The inverse of H + λD, with H averaged over groups of frames, and λD.

        Unknowns act on M from the right, so that the block of bones j and k depends on the frame
        only through R_jᵀ R_k.  This varies slowly; consecutive frames share one inverse, which is
        applied to all of them by a matrix product.
        """
        n_frames, n_bones = self.model.transforms.shape[:2]
        generators, frame_weight = self.generators, self.data.frame_scale**2
        n_tangent = generators.shape[2]
        size = n_tangent * n_bones
        index = np.arange(n_bones)
        own = np.einsum("dca,jde,ecb->jab", generators, u[index, index], generators)
        own = np.maximum(np.einsum("jaa->ja", own), 1e-300)
        own = np.maximum(own, 1e-12 * own.max())
        groups = chunk_bounds(n_frames, max(_GROUP, -(-n_frames // _GROUPS)))
        rotation = np.ascontiguousarray(self.model.transforms[..., :3])
        table = u.transpose(2, 3, 0, 1).reshape(1, 16, -1)
        # coefficients of the products turn[c, f] · table[d, e]
        signs = np.einsum("dca,efb->abcfde", generators, generators).reshape(n_tangent**2, 144)

        def invert_group(_: int, i: int, k: int) -> Array:
            stack = rotation[i:k].transpose(0, 2, 3, 1).reshape(3 * (k - i), 3 * n_bones)
            turn = (stack.T @ stack).reshape(3, n_bones, 3, n_bones) / (k - i)
            turn = turn.transpose(0, 2, 1, 3).reshape(9, 1, -1)
            mean = signs @ (turn * table).reshape(144, -1)
            mean = mean.reshape(n_tangent, n_tangent, n_bones, n_bones)
            matrix = np.ascontiguousarray(mean.transpose(2, 0, 3, 1)).reshape(size, size)
            matrix[np.diag_indices(size)] += (damping + 1e-9) * own.ravel()
            return inverse_of(matrix)

        inverses = run_chunks(invert_group, groups)
        together = None
        if patches is not None:
            of_patches = patches.transpose(2, 3, 0, 1).reshape(16, -1)
            both = np.einsum("dca,ecb->abde", generators, generators).reshape(n_tangent**2, 16)
            matrix = (both @ of_patches).reshape(n_tangent, n_tangent, n_bones, n_bones)
            matrix = np.ascontiguousarray(matrix.transpose(2, 0, 3, 1)).reshape(size, size)
            matrix[np.diag_indices(size)] += (damping + _SAME) * frame_weight.sum() * own.ravel()
            together = inverse_of(matrix)

        def precondition(r: Array) -> Array:
            flat = r.reshape(n_frames, size) / frame_weight[:, None]
            out = np.empty_like(flat)
            run_chunks(lambda g, i, k: np.matmul(flat[i:k], inverses[g], out=out[i:k]), groups)
            if together is not None:
                out += together @ r.reshape(n_frames, size).sum(axis=0)
            return out.reshape(r.shape)

        damped = damping * (frame_weight[:, None, None] * own)
        return precondition, lambda x: damped * x


# the generator of σ, which adds σ p to the change of p
_GROWTH = np.concatenate([np.eye(3), np.zeros((1, 3))])[:, :, None]


class SimilarityTangent(RigidTangent):
    """Unknowns x (F, B, 7): (ω, τ, σ) of each bone, with δM = M [[ω]× + σI, τ; 0 0]."""

    precision = np.float64
    generators = np.concatenate([GENERATORS, _GROWTH], axis=2)

    def image(self, x: Array) -> Array:
        scale = self.data.frame_scale
        m = np.ascontiguousarray(self.model.transforms.transpose(0, 2, 3, 1))
        x = np.ascontiguousarray((x * scale[:, None, None]).transpose(2, 0, 1))[:, :, None]
        out = np.empty_like(m)
        out[:, :, 3] = 0.0
        for d in range(3):
            e, f = (d + 1) % 3, (d + 2) % 3
            out[:, :, d] = m[:, :, e] * x[f] - m[:, :, f] * x[e] + m[:, :, d] * x[6]
            out[:, :, 3] += m[:, :, d] * x[3 + d]
        return out.reshape(-1, 4 * m.shape[3])

    def pullback(self, gradient: Array) -> Array:
        scale = self.data.frame_scale
        m = np.ascontiguousarray(self.model.transforms.transpose(0, 2, 3, 1))
        g = gradient.reshape(m.shape)
        out = np.empty((7, len(m), m.shape[3]))
        out[6] = 0.0
        for d in range(3):
            e, f = (d + 1) % 3, (d + 2) % 3
            out[d] = (m[:, :, f] * g[:, :, e] - m[:, :, e] * g[:, :, f]).sum(axis=1)
            out[3 + d] = (m[:, :, d] * g[:, :, 3]).sum(axis=1)
            out[6] += (m[:, :, d] * g[:, :, d]).sum(axis=1)
        return np.ascontiguousarray((out * scale[:, None]).transpose(1, 2, 0))

    def move(self, model: Model, x: Array) -> None:
        """Replace M by M exp(x), with its size kept within the allowed range (in place)."""
        super().move(model, np.ascontiguousarray(x[..., :6]))
        m = model.transforms
        size = np.linalg.norm(m[..., 0], axis=-1)
        grown = size * np.exp(np.clip(x[..., 6], -1.0, 1.0))
        grown = np.clip(grown, np.minimum(size, SMALLEST), np.maximum(size, LARGEST))
        m[..., :3] *= (grown / size)[..., None, None]


class AffineTangent(Tangent):
    """Unknowns x (F, B, 12): the change of the twelve entries of each transform.

    The Gauss–Newton matrix H is the same for every frame and axis, up to the importance of the
    frame.
    """

    def image(self, x: Array) -> Array:
        return self.data.stack(x.reshape(*x.shape[:2], 3, 4))

    def pullback(self, gradient: Array) -> Array:
        scale = self.data.frame_scale
        out = unstack_transforms(gradient, self.model.n_bones) * scale[:, None, None, None]
        return np.ascontiguousarray(out).reshape(*out.shape[:2], 12)

    def move(self, model: Model, x: Array) -> None:
        """Replace M by M + x (in place), except where it is not admissible.

        A matrix is not admissible if it is reflected, too flat or too large.
        """
        m = model.transforms
        moved = m + x.reshape(m.shape)
        good = admissible(m, moved)
        m[good] = moved[good]

    def precondition(
        self, u: Array, damping: float, patches: Array | None = None
    ) -> tuple[Operator, Operator]:
        """The exact inverse of H + λD, and λD; D is the quadratic form of :func:`ridge_blocks`."""
        metric = stack_diagonal(ridge_blocks(u, 1.0))
        damped = damping * metric
        matrix = stack_blocks(u) + damped + 1e-9 * metric
        try:
            inverse = np.linalg.inv(matrix)
        except np.linalg.LinAlgError:  # a bone that moves one point, far from the origin
            inverse = np.linalg.pinv(matrix, hermitian=True)
        inverse = 0.5 * (inverse + inverse.T)
        weight = self.data.frame_scale[:, None, None] ** 2

        def times(x: Array, matrix: Array) -> Array:
            stacked = stack_transforms(x.reshape(*x.shape[:2], 3, 4)) @ matrix
            return np.ascontiguousarray(unstack_transforms(stacked, len(u))).reshape(x.shape)

        together, axes = None, self.model.transforms[..., :3]
        if patches is not None:
            same = (damping + _SAME) * float(weight.sum()) * metric
            together = inverse_of(stack_blocks(patches) + same)

        def precondition(r: Array) -> Array:
            out = times(r, inverse) / weight
            if together is not None:
                # with M X for X the change of all frames, as sums over the frames
                x = np.einsum("tjca,tjcd->jad", axes, r.reshape(*r.shape[:2], 3, 4))
                x = unstack_transforms(stack_transforms(x[None]) @ together, len(u))[0]
                out += np.einsum("tjca,jad->tjcd", axes, x).reshape(r.shape)
            return out

        return precondition, lambda x: times(x, damped) * weight
