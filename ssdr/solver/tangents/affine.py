"""Unknowns of affine bones: the twelve entries of each transform."""

from __future__ import annotations

import numpy as np

from ..affine_fit import admissible, ridge_blocks, stack_diagonal
from ..conjugate_gradients import Operator
from ..model import Model
from ..moments import stack_blocks
from ..trajectories import Array, stack_transforms, unstack_transforms
from .tangent import Tangent


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

    def precondition(self, u: Array, damping: float) -> tuple[Operator, Operator]:
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

        def precondition(r: Array) -> Array:
            return times(r, inverse) / weight

        return precondition, lambda x: times(x, damped) * weight
