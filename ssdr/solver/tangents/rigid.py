"""Unknowns of rigid bones: a rotation and a translation of each bone, in its own axes."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...kernels.schur import move_bones, tangent_image, tangent_pullback
from ...parallel import chunk_bounds, run_chunks
from ..conjugate_gradients import Operator
from ..model import Model
from ..trajectories import Array
from .tangent import Tangent, inverse_of

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

    def precondition(self, u: Array, damping: float) -> tuple[Operator, Operator]:
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

        def precondition(r: Array) -> Array:
            flat = r.reshape(n_frames, size) / frame_weight[:, None]
            out = np.empty_like(flat)
            run_chunks(lambda g, i, k: np.matmul(flat[i:k], inverses[g], out=out[i:k]), groups)
            return out.reshape(r.shape)

        damped = damping * (frame_weight[:, None, None] * own)
        return precondition, lambda x: damped * x
