"""Decorators that compile kernels and their helpers.

Numba compiles a cached kernel again only if the kernel's own file changes.  After a change of a
helper in another file, delete ``ssdr/kernels/__pycache__``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile a kernel that releases the GIL, is cached on disk and divides by 0 as NumPy does."""
    compiled: Any = numba.njit(nogil=True, cache=True, error_model="numpy")(function)
    return compiled  # type: ignore[no-any-return]


def inline(function: Function) -> Function:
    """Compile a helper of kernels, cached as part of each kernel; its integers have 64 bits."""
    njit: Any = numba.njit  # its stubs do not know the last two options
    compiled: Any = njit(
        nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True
    )(function)
    resolve = getattr(compiled, "get_call_template", None)
    if resolve is not None:
        # Otherwise Numba compiles a helper for each type of integer and, while it infers the
        # types of a kernel, for literals: half of the time of compiling all kernels.
        compiled.get_call_template = lambda args, kws: resolve(tuple(map(_wide, args)), kws)
    return compiled  # type: ignore[no-any-return]


def _wide(kind: Any) -> Any:
    return numba.types.int64 if isinstance(kind, numba.types.Integer) else kind
