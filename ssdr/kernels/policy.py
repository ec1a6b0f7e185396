"""The one place that says how kernels are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile without the GIL, cached on disk, IEEE arithmetic (NaN must be seen)."""
    compiled: Any = numba.njit(nogil=True, cache=True, error_model="numpy")(function)
    return compiled  # type: ignore[no-any-return]


def inline(function: Function) -> Function:
    """Compile a helper that only kernels call; it is cached as part of them."""
    njit: Any = numba.njit  # its stubs do not know the last two options
    compiled: Any = njit(
        nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True
    )(function)
    return compiled  # type: ignore[no-any-return]
