"""How the simulator's kernels are compiled, and the constants that they share.

Numba's cache on disk depends on the date of a kernel's own file alone.  After a change of a helper
in another file, delete ``garmentnet/scenes/xpbd/__pycache__``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np

__all__ = ["LANES", "REAL", "TINY", "kernel"]

Function = TypeVar("Function", bound=Callable[..., Any])

REAL = np.float32
# Constraints that are gathered, computed and scattered together; a multiple of every SIMD width.
LANES = 32
# Added to squared lengths before a division.
TINY = REAL(1e-20)


def kernel(function: Function) -> Function:
    """Compile without the GIL and with the compiler's freedom to reorder sums.

    The order is fixed when the kernel is compiled, so that a clip has the same bits on every run.
    NaN is not tested for inside a kernel.
    """
    compiled: Any = numba.njit(nogil=True, cache=True, fastmath=True, error_model="numpy")(function)
    return compiled
