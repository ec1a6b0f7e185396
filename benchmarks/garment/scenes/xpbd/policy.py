"""Decorator that compiles the simulator's kernels, and the constants that they share.

Numba compiles a cached kernel again only if the kernel's own file changes.  After a change of a
helper in another file, delete ``benchmarks/garment/scenes/xpbd/__pycache__``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np

Function = TypeVar("Function", bound=Callable[..., Any])

REAL = np.float32
# Compiled code tests every signed index for being negative, which takes a third of a sweep.
INDEX = np.uint64
ONE, TWO, THREE = INDEX(1), INDEX(2), INDEX(3)
# Constraints that are gathered, computed and scattered together; a multiple of every SIMD width.
LANES = 32
# Added to squared lengths before a division.
TINY = REAL(1e-20)
_POLICY: Any = {"nogil": True, "cache": True, "error_model": "numpy"}


def kernel(function: Function) -> Function:
    """Compile a kernel that releases the GIL and in which the compiler may reorder sums.

    The order is fixed when the kernel is compiled, so that a clip has the same bits on every run.
    A kernel cannot test for NaN.
    """
    compiled: Any = numba.njit(fastmath=True, **_POLICY)(function)
    return compiled


def ordered_kernel(function: Function) -> Function:
    """Compile a kernel that releases the GIL and in which sums keep their order.

    It compares numbers that are nearly equal: inlined or not, new or from the cache, it must come
    to the same decision.
    """
    compiled: Any = numba.njit(fastmath={"nnan", "ninf", "nsz"}, **_POLICY)(function)
    return compiled
