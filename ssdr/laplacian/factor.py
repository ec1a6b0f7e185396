"""Sparse symmetric positive definite systems: CHOLMOD where installed, SuperLU otherwise.

CHOLMOD is an extra because its packages have no wheels and its fast parts are
under the GPL; everything works without it, only slower.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from ..errors import InputError, MissingDependencyError
from ..parallel import serial_blas

__all__ = ["Backend", "Factor", "factor_spd"]

Backend = Literal["cholmod", "scipy"]


@dataclasses.dataclass(frozen=True, eq=False)
class Factor:
    """A factor of a matrix A, kept for many right-hand sides.

    Attributes
    ----------
    backend : {"cholmod", "scipy"}
    solve : callable
        ``solve(b)`` gives x of A x = b for b ``(n,)`` or ``(n, m)`` float64,
        fastest where b is in Fortran order.
    """

    backend: Backend
    solve: Callable[[NDArray[np.float64]], NDArray[np.float64]]


def factor_spd(matrix: Any, *, backend: Backend | None = None) -> Factor:
    """Factor a symmetric positive definite matrix.

    Parameters
    ----------
    matrix : (n, n) sparse matrix or array
        Both triangles stored.
    backend : {"cholmod", "scipy"}, optional
        CHOLMOD (scikit-sparse 0.4 or 0.5) where installed, otherwise SciPy's
        SuperLU without pivoting.

    Raises
    ------
    InputError
        If `backend` is unknown.
    MissingDependencyError
        If CHOLMOD is asked for and scikit-sparse is not installed.
    ArithmeticError
        If the matrix is singular or, with CHOLMOD, not positive definite to
        working precision.

    References
    ----------
    Chen et al., "Algorithm 887: CHOLMOD", 2008.
    """
    if backend is not None and not (isinstance(backend, str) and backend in get_args(Backend)):
        raise InputError("backend", f"one of {get_args(Backend)} or None", repr(backend))
    system = csc_matrix(matrix)
    if backend != "scipy":
        try:
            return Factor("cholmod", _cholmod(system))
        except ImportError as error:
            if backend == "cholmod":
                raise MissingDependencyError(
                    "CHOLMOD needs scikit-sparse and SuiteSparse with its headers: "
                    'pip install "ssdr[cholmod]"'
                ) from error
    return Factor("scipy", _superlu(system))


def _superlu(system: csc_matrix) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    # Shuffled first: minimum degree is 100 times slower on the numbering of a subdivided mesh.
    order = np.random.default_rng(0).permutation(system.shape[0])
    back = np.argsort(order)
    try:
        with serial_blas():
            lu = splu(
                system[order][:, order].tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
    except RuntimeError as error:
        raise ArithmeticError(str(error)) from error

    def solve(b: NDArray[np.float64]) -> NDArray[np.float64]:
        # SuperLU's blocks are small: with threads of BLAS it is four times slower.
        with serial_blas():
            return np.asarray(lu.solve(np.asfortranarray(b[order]))[back])

    return solve


def _cholmod(system: csc_matrix) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    from sksparse import cholmod

    try:
        if hasattr(cholmod, "cho_factor"):  # scikit-sparse 0.5
            solve: Any = cholmod.cho_factor(system).solve
        else:
            solve = cholmod.cholesky(system)
    except cholmod.CholmodError as error:
        raise ArithmeticError(str(error)) from error
    return lambda b: np.asarray(solve(b))
