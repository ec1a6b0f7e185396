"""Dense products and inverses, shared over threads in fixed pieces: the same bits always."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from ..parallel import chunk_bounds, run_chunks
from .trajectories import Array

__all__ = ["cross_product", "grouped_product", "inverse_of", "product"]

# Rows or columns of a piece: fewer make a product slow, more leave threads idle.  Where its
# multiplications are few, handing it out costs more than it saves.
_PIECE, _MULTIPLICATIONS = 96, 2_000_000


def product(left: Array, right: Array) -> Array:
    """left @ right, rows beside each other."""
    out = np.empty((len(left), right.shape[1]), dtype=left.dtype)
    bounds = _pieces(len(left), right.size)
    run_chunks(lambda _, i, k: np.matmul(left[i:k], right, out=out[i:k]), bounds)
    return out


def cross_product(left: Array, right: Array) -> Array:
    """leftᵀ @ right, columns beside each other: no sum is split."""
    out = np.empty((right.shape[1], left.shape[1]), dtype=left.dtype)
    bounds = _pieces(right.shape[1], left.size)
    run_chunks(lambda _, i, k: np.matmul(right[:, i:k].T, left, out=out[i:k]), bounds)
    return out.T


def grouped_product(left: Array, groups: list[tuple[int, int]], right: list[Array]) -> Array:
    """Each group of rows of left, by its bounds, times a matrix of its own."""
    out = np.empty((len(left), right[0].shape[1]))
    each = left.size * right[0].shape[1] // len(groups)

    def multiply(_: int, first: int, last: int) -> None:
        for (i, k), matrix in zip(groups[first:last], right[first:last], strict=True):
            np.matmul(left[i:k], matrix, out=out[i:k])

    run_chunks(multiply, chunk_bounds(len(groups), -(-_MULTIPLICATIONS // max(1, each))))
    return out


def _pieces(count: int, each: int) -> list[tuple[int, int]]:
    """Bounds of the pieces of `count` rows of `each` multiplications."""
    return chunk_bounds(count, max(_PIECE, -(-_MULTIPLICATIONS // max(1, each))))


def inverse_of(matrix: Array) -> Array:
    """Inverse of a positive definite matrix, by Cholesky; symmetric to the bit.

    Half the operations of a general inverse.  A matrix that rounding has left indefinite is
    inverted all the same.
    """
    factor, failed = lapack.dpotrf(matrix, lower=1)
    if not failed:
        inverse, failed = lapack.dpotri(factor, lower=1)
    if failed:
        inverse = np.linalg.inv(matrix)
    lower = np.tril(inverse)
    return np.asarray(lower + np.tril(inverse, -1).T)
