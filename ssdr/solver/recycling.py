"""Directions of one solve by conjugate gradients, for the preconditioner of the next.

References
----------
Morales and Nocedal, "Automatic preconditioning by limited memory quasi-Newton updating", 2000.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from ..errors import InputError
from .trajectories import Array

__all__ = ["Recycled"]

_NUMBERS = 1 << 21  # at most so many of the directions, and of their images, are kept


@dataclasses.dataclass(frozen=True, eq=False)
class Recycled:
    """Conjugate directions s with their images y = A s.

    Steps of one polish solve nearly the same system again and again.  What a solve has learned of
    it is handed on: with V = I − Σ y sᵀ / (sᵀ y) the next one is preconditioned by
    Vᵀ P V + Σ s sᵀ / (sᵀ y) in place of P, which is A⁻¹ on the span of the directions and positive
    definite wherever P is.

    Attributes
    ----------
    directions, images : (m, n) float64
    """

    directions: Array
    images: Array

    @staticmethod
    def of(pairs: list[tuple[Array, Array]]) -> Recycled | None:
        """The first of the pairs (direction, image) of a solve, as many as memory is meant for."""
        few = pairs[: _NUMBERS // max(1, pairs[0][0].size)] if pairs else []
        if not few:
            return None
        directions, images = (np.stack([p[k].ravel() for p in few]) for k in (0, 1))
        return Recycled(directions, images)

    def around(self, precondition: Callable[[Array], Array], size: int) -> Callable[[Array], Array]:
        """The preconditioner P of so many numbers with what the directions know.

        Raises
        ------
        InputError
            If the directions are of another number.
        """
        s, y = self.directions, self.images
        if s.shape[1] != size:
            raise InputError("recycled", f"directions of {size} numbers", s.shape[1])
        curvature = np.einsum("mn,mn->m", s, y)

        def apply(r: Array) -> Array:
            flat = r.ravel()
            along = (s @ flat) / curvature
            z = precondition((flat - along @ y).reshape(r.shape)).ravel()
            out: Array = z + (along - (y @ z) / curvature) @ s
            return out.reshape(r.shape)

        return apply
