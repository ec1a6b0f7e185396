"""Arrays as arguments: of the right shape, real and finite."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import InputError

__all__ = ["floats_of", "frame_index"]


def frame_index(frames: Any, n_frames: int) -> Any:
    """What picks frames from an array: a slice, a mask or indices, checked."""
    if isinstance(frames, slice):
        return frames
    index = np.atleast_1d(np.asarray(frames))
    if index.dtype == bool and index.shape == (n_frames,):
        return index
    usable = index.ndim == 1 and (index.dtype.kind in "iu" or index.size == 0)
    if not usable or (index.size and not -n_frames <= index.min() <= index.max() < n_frames):
        raise InputError("frames", f"indices below {n_frames}, a slice or a mask", frames)
    return index.astype(np.intp)


def floats_of(value: Any, argument: str, shape: tuple[Any, ...]) -> NDArray[np.floating]:
    """Real, finite numbers of a shape whose letters may be any size but 0, float32 or float64."""
    array = np.asarray(value)
    wanted = f"shape ({', '.join(str(s) for s in shape)})"
    if array.ndim != len(shape) or any(
        isinstance(s, int) and s != n for s, n in zip(shape, array.shape, strict=True)
    ):
        raise InputError(argument, wanted, f"shape {array.shape}")
    if array.size == 0:
        raise InputError(argument, f"{wanted}, none of them 0", f"shape {array.shape}")
    if array.dtype.kind not in "fiu":
        raise InputError(argument, "real numbers", f"dtype {array.dtype}")
    if array.dtype not in (np.dtype(np.float32), np.dtype(np.float64)):
        array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise InputError(argument, "finite numbers", "NaN or Inf")
    return np.ascontiguousarray(array)
