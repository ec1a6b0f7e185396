"""Dense products and inverses in threads; results do not depend on the number of threads."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from ..parallel import chunk_bounds, run_chunks
from .trajectories import Array

__all__ = ["cross_product", "inverse_of", "product"]

# Fewest rows and multiplications of a piece: small products are slow, and handing them to threads
# costs more than it saves.
_PIECE, _MULTIPLICATIONS = 96, 2_000_000


def product(left: Array, right: Array) -> Array:
    """Product left @ right, computed in parallel for pieces of its rows."""
    out = np.empty((len(left), right.shape[1]), dtype=left.dtype)
    bounds = chunk_bounds(len(left), max(_PIECE, -(-_MULTIPLICATIONS // max(1, right.size))))
    run_chunks(lambda _, i, k: np.matmul(left[i:k], right, out=out[i:k]), bounds)
    return out


def cross_product(left: Array, right: Array) -> Array:
    """Product leftᵀ @ right, computed in parallel for pieces of its columns, so no sum is split."""
    return product(right.T, left).T


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
