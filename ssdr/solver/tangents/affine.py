"""Affine bones: the twelve numbers of each transform."""

from __future__ import annotations

import numpy as np

from ..affine import admissible, flat_blocks, ridge_blocks
from ..conjugate_gradients import Operator
from ..model import Model
from ..trajectories import Array
from .tangent import Tangent

__all__ = ["AffineTangent"]


class AffineTangent(Tangent):
    """x (F, B, 12), the change of a transform: H is the same for every row of every frame."""

    def image(self, x: Array) -> Array:
        return self.data.hat(x.reshape(*x.shape[:2], 3, 4))

    def pullback(self, gradient: Array) -> Array:
        n_frames, n_bones = self.model.transforms.shape[:2]
        blocks = gradient.reshape(n_frames, 3, 4, n_bones)
        blocks = blocks * self.data.frame_scale[:, None, None, None]
        out = np.ascontiguousarray(blocks.transpose(0, 3, 1, 2)).reshape(n_frames, n_bones, 12)
        out[:, self.locked] = 0.0
        return out

    def move(self, model: Model, x: Array) -> None:
        """M ← M + x, where that is admissible."""
        m = model.transforms
        moved = m + x.reshape(m.shape)
        good = admissible(m, moved) & ~self.locked
        m[good] = moved[good]

    def precondition(self, u: Array, damping: float) -> tuple[Operator, Operator]:
        """The exact inverse of H + λD, and λD, with D the spread of each bone."""
        n_bones = len(u)
        metric = ridge_blocks(u, 1.0)
        index = np.arange(n_bones)
        damped = np.zeros_like(u)
        damped[index, index] = damping * metric
        own = np.zeros_like(u)
        own[index, index] = 1e-9 * metric
        matrix = flat_blocks(u + damped + own)
        try:
            inverse = np.linalg.inv(matrix)
        except np.linalg.LinAlgError:  # a bone that moves one point, far from the origin
            inverse = np.linalg.pinv(matrix, hermitian=True)
        inverse = 0.5 * (inverse + inverse.T)
        flat_damped = flat_blocks(damped)
        weight = self.data.frame_scale[:, None, None] ** 2

        def times(x: Array, matrix: Array) -> Array:
            n_frames = len(x)
            flat = x.reshape(n_frames, n_bones, 3, 4).transpose(0, 2, 3, 1)
            flat = np.ascontiguousarray(flat).reshape(3 * n_frames, 4 * n_bones) @ matrix
            back = flat.reshape(n_frames, 3, 4, n_bones).transpose(0, 3, 1, 2)
            return np.ascontiguousarray(back).reshape(x.shape)

        def precondition(r: Array) -> Array:
            out = times(r, inverse) / weight
            out[:, self.locked] = 0.0
            return out

        return precondition, lambda x: times(x, flat_damped) * weight
