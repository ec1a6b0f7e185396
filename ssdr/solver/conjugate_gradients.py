"""Preconditioned conjugate gradients whose directions speed up the solve of the next system.

References
----------
Morales and Nocedal, "Automatic preconditioning by limited memory quasi-Newton updating", 2000.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from ..common.parallel import chunk_bounds, run_chunks
from .trajectories import Array

Operator = Callable[[Array], Array]  # a linear map of arrays of one shape

_CONVERGED = 1e-10  # squared residual rᵀ P r, relative to the first, that ends the iteration
_NUMBERS = 1 << 21  # most floats in all stored directions together, and as many in their images
_COLUMNS = 1 << 14  # columns of directions and images on which a thread works at once


def conjugate_gradients(
    apply: Operator, rhs: Array, precondition: Operator, *, steps: int, recycled: Recycled | None
) -> tuple[Array, Array, Recycled | None]:
    """Solve A x = b for a symmetric positive definite matrix A, from x = 0.

    Parameters
    ----------
    apply : callable
        Multiplies an array by A.
    rhs : array
        b.
    precondition : callable
        Multiplies an array by a symmetric positive definite approximation of A⁻¹.
    steps : int
        Largest number of products with A.
    recycled : Recycled or None
        Directions of an earlier, similar system.

    Returns
    -------
    x, residual : arrays
        The solution, and the residual b − A x as the iteration updates it.
    recycled : Recycled or None
        Directions for the next system.
    """
    if recycled is not None:
        precondition = recycled.update(precondition)
    x, residual = np.zeros_like(rhs), rhs.copy()
    z = precondition(residual)
    direction = z.copy()
    rho = first = float(np.vdot(residual, z))
    pairs: list[tuple[Array, Array]] = []
    for _ in range(steps):
        if not rho > _CONVERGED * first:
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
    return x, residual, Recycled.of(pairs) or recycled


@dataclasses.dataclass(frozen=True, eq=False)
class Recycled:
    """Conjugate directions s with their images y = A s, scaled to sᵀ y = 1.

    Consecutive Gauss–Newton steps solve nearly the same system.  If P is the preconditioner of the
    next system, its solve takes Vᵀ P V + Σ s sᵀ instead, with V = I − Σ y sᵀ.  This matrix inverts
    A exactly on the span of the images and is positive definite if P is.

    Attributes
    ----------
    directions, images : (m, n) float64
        A row for each of m pairs s, y.
    """

    directions: Array
    images: Array

    @staticmethod
    def of(pairs: list[tuple[Array, Array]]) -> Recycled | None:
        """Scale and store the first pairs (direction, image), as many as fit into the memory.

        Returns None if there are none.
        """
        few = pairs[: _NUMBERS // max(1, pairs[0][0].size)] if pairs else []
        if not few:
            return None
        directions = np.empty((len(few), few[0][0].size))
        images = np.empty_like(directions)
        for k, (direction, image) in enumerate(few):
            scale = 1.0 / np.sqrt(np.vdot(direction, image))
            directions[k], images[k] = scale * direction.ravel(), scale * image.ravel()
        return Recycled(directions, images)

    def update(self, precondition: Operator) -> Operator:
        """Operator that applies Vᵀ P V + Σ s sᵀ, as the class defines it.

        It is the preconditioner P = `precondition`, improved by these directions.
        """
        s, y = self.directions, self.images
        pieces = chunk_bounds(s.shape[1], _COLUMNS)

        def products(rows: Array, x: Array) -> Array:
            parts = run_chunks(lambda _, i, k: rows[:, i:k] @ x[i:k], pieces)
            return np.asarray(np.sum(parts, axis=0))

        def plus(x: Array, factors: Array, rows: Array) -> Array:
            out = np.empty_like(x)
            run_chunks(lambda _, i, k: np.add(x[i:k], factors @ rows[:, i:k], out=out[i:k]), pieces)
            return out

        def updated(r: Array) -> Array:
            flat = r.ravel()
            share = products(s, flat)
            z = precondition(plus(flat, -share, y).reshape(r.shape)).ravel()
            return plus(z, share - products(y, z), s).reshape(r.shape)

        return updated
