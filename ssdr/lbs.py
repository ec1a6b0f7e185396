"""Forward linear blend skinning (LBS)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .checks import check_range, remedy_of_shape
from .errors import InputError
from .kernels.lbs import skin_range
from .parallel import chunk_bounds, run_chunks

__all__ = ["skin"]

# vertices in a task; smaller tasks cost more calls, larger ones balance threads worse
_VERTEX_CHUNK = 1024


def skin(
    rest: ArrayLike,
    indices: ArrayLike,
    weights: ArrayLike,
    transforms: ArrayLike,
    *,
    dtype: Any = None,
) -> NDArray[np.floating]:
    """Linear blend skinning: v_i^t = Σ_k w_ik M_{j_ik}^t (p_i, 1).

    Parameters
    ----------
    rest : (V, 3) array
    indices : (V, K) int array
    weights : (V, K) array
    transforms : (F, B, 3, 4) or (B, 3, 4) array
    dtype : float32 or float64, optional
        Precision of the computation and of the result; the widest of the
        inputs by default.

    Returns
    -------
    (F, V, 3) array, or (V, 3) for a single frame.

    Raises
    ------
    InputError
        If shapes do not match or an index is out of range.

    References
    ----------
    Magnenat-Thalmann et al., "Joint-dependent local deformations", 1988.

    Examples
    --------
    >>> move = np.eye(3, 4)[None]
    >>> move[0, :, 3] = [1, 2, 3]
    >>> posed = ssdr.skin(np.zeros((2, 3)), np.zeros((2, 1), int), np.ones((2, 1)), move)
    >>> np.allclose(posed, [1, 2, 3])
    True
    """
    p, w, m = np.asarray(rest), np.asarray(weights), np.asarray(transforms)
    j = np.asarray(indices)
    if p.ndim != 2 or p.shape[1] != 3:
        raise InputError("rest", "shape (V, 3)", f"shape {p.shape}")
    if j.ndim != 2 or len(j) != len(p) or j.shape[1] < 1 or j.dtype.kind not in "iu":
        raise InputError("indices", f"integers of shape ({len(p)}, K)", f"{j.dtype} {j.shape}")
    if w.shape != j.shape:
        raise InputError("weights", f"shape {j.shape}", f"shape {w.shape}")
    if m.ndim not in (3, 4) or m.shape[-2:] != (3, 4):
        wanted = f"shape (F, B, 3, 4) or (B, 3, 4){remedy_of_shape(m.shape, (3, 4))}"
        raise InputError("transforms", wanted, f"shape {m.shape}")
    check_range(j, "indices", m.shape[-3])
    for name, array in (("rest", p), ("weights", w), ("transforms", m)):
        if array.dtype.kind not in "fiu":
            raise InputError(name, "real numbers", f"dtype {array.dtype}")
    try:
        kind = np.result_type(p, w, m) if dtype is None else np.dtype(dtype)
    except (TypeError, ValueError) as error:
        raise InputError("dtype", "float32, float64 or None", repr(dtype)) from error
    if kind not in (np.dtype(np.float32), np.dtype(np.float64)):
        kind = np.dtype(np.float64)
    p, w, m = (np.ascontiguousarray(a, dtype=kind) for a in (p, w, m))
    j = np.ascontiguousarray(j, dtype=np.int32)
    frames = m if m.ndim == 4 else m[None]
    out = np.empty((len(frames), len(p), 3), dtype=kind)

    def work(_: int, first: int, last: int) -> None:
        skin_range(p, j, w, frames, out, first, last)

    run_chunks(work, chunk_bounds(len(p), _VERTEX_CHUNK))
    return out if m.ndim == 4 else out[0]
