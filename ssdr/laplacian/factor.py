"""Solvers of sparse symmetric positive definite systems: CHOLMOD if installed, or SuperLU.

CHOLMOD is optional, since its packages have no wheels and its fast parts are under the GPL.
Without it everything works, only slower.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from ..common.errors import MissingDependencyError, check_choice
from ..common.parallel import serial_blas

Backend = Literal["cholmod", "scipy"]


Solve = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def factor_spd(matrix: Any, *, backend: Backend | None = None) -> tuple[Solve, Backend]:
    """Factor a symmetric positive definite matrix.

    Parameters
    ----------
    matrix : (n, n) sparse matrix or array
        Matrix with both triangles stored.
    backend : {"cholmod", "scipy"}, optional
        CHOLMOD (scikit-sparse 0.4 or 0.5) where installed, otherwise SciPy's
        SuperLU without pivoting.

    Returns
    -------
    solve : callable
        Solves A x = b for b ``(n,)`` or ``(n, m)`` float64, fastest in Fortran order.
    backend : {"cholmod", "scipy"}
        The library that made the factor.

    Raises
    ------
    InputError
        If `backend` is unknown.
    MissingDependencyError
        If `backend` is "cholmod" and scikit-sparse is not installed.
    ArithmeticError
        If the matrix is singular or, with CHOLMOD, not positive definite to
        working precision.

    References
    ----------
    Chen et al., "Algorithm 887: CHOLMOD", 2008.
    """
    if backend is not None:
        check_choice(backend, "backend", Backend)
    system = csc_matrix(matrix)
    if backend != "scipy":
        try:
            return _cholmod(system), "cholmod"
        except ImportError as error:
            if backend == "cholmod":
                raise MissingDependencyError(
                    "CHOLMOD needs scikit-sparse and SuiteSparse with its headers: "
                    'pip install "scikit-sparse>=0.4.15"'
                ) from error
    return _superlu(system), "scipy"


def _superlu(system: csc_matrix) -> Solve:
    # Shuffled first, since minimum degree is 100 times slower in the order of a subdivided mesh.
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
        # SuperLU's blocks are small, so that a threaded BLAS is four times slower.
        with serial_blas():
            return np.asarray(lu.solve(np.asfortranarray(b[order]))[back])

    return solve


def _cholmod(system: csc_matrix) -> Solve:
    from sksparse import cholmod

    try:
        if hasattr(cholmod, "cho_factor"):  # scikit-sparse 0.5
            solve: Any = cholmod.cho_factor(system).solve
        else:
            solve = cholmod.cholesky(system)
    except cholmod.CholmodError as error:
        raise ArithmeticError(str(error)) from error
    return lambda b: np.asarray(solve(b))
