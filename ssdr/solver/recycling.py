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
from ..parallel import chunk_bounds, run_chunks
from .trajectories import Array

__all__ = ["Recycled"]

_NUMBERS = 1 << 21  # at most so many of the directions, and of their images, are kept
_COLUMNS = 1 << 14  # of both, that a thread works on at once


@dataclasses.dataclass(frozen=True, eq=False)
class Recycled:
    """Conjugate directions s with their images y = A s, scaled to sᵀ y = 1.

    Steps of one polish solve nearly the same system again and again.  What a solve has learned of
    it is handed on: with V = I − Σ y sᵀ the next one is preconditioned by Vᵀ P V + Σ s sᵀ in place
    of P, which is A⁻¹ on the span of the directions and positive definite wherever P is.

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
        directions, images = (np.empty((len(few), few[0][0].size)) for _ in range(2))
        for k, (direction, image) in enumerate(few):
            scale = 1.0 / np.sqrt(np.vdot(direction, image))
            directions[k], images[k] = scale * direction.ravel(), scale * image.ravel()
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
        pieces = chunk_bounds(size, _COLUMNS)

        def along(rows: Array, x: Array) -> Array:
            parts = run_chunks(lambda _, i, k: rows[:, i:k] @ x[i:k], pieces)
            return np.asarray(np.sum(parts, axis=0))

        def plus(x: Array, factors: Array, rows: Array) -> Array:
            out = np.empty_like(x)
            run_chunks(lambda _, i, k: np.add(x[i:k], factors @ rows[:, i:k], out=out[i:k]), pieces)
            return out

        def apply(r: Array) -> Array:
            flat = r.ravel()
            share = along(s, flat)
            z = precondition(plus(flat, -share, y).reshape(r.shape)).ravel()
            return plus(z, share - along(y, z), s).reshape(r.shape)

        return apply
