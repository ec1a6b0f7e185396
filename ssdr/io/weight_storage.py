"""Skin weights as files store them: integers whose sum at a vertex is the maximum of their type."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..common.errors import check_choice

WeightStorage = Literal["float32", "uint16", "uint8"]


def quantise(
    indices: NDArray[np.int32], weights: NDArray[np.float64], storage: WeightStorage
) -> tuple[NDArray[np.int32], NDArray[Any]]:
    """Round weights as a file stores them, so that those of a vertex sum to exactly 1.

    Returns
    -------
    indices : (V, K) int32
        As given, but 0 where the stored weight is 0, as glTF requires.
    stored : (V, K) float32, uint16 or uint8

    Raises
    ------
    InputError
        If `storage` is unknown.
    """
    check_choice(storage, "weights", WeightStorage)
    stored: NDArray[Any] = weights.astype(np.float32)
    if storage == "float32":
        stored[:, 0] = 1.0 - stored[:, 1:].sum(axis=1, dtype=np.float64)
    else:
        steps = np.iinfo(storage).max
        scaled = weights * steps
        whole = np.floor(scaled)
        # The largest remainders are rounded up: rows keep their sum with the least error.
        order = np.argsort(-np.where(weights > 0, scaled - whole, -1.0), axis=1, kind="stable")
        rank = np.argsort(order, axis=1, kind="stable")
        whole += rank < np.rint(steps - whole.sum(axis=1))[:, None]
        stored = whole.astype(storage)
    return np.where(stored > 0, indices, 0).astype(np.int32), stored


def weight_values(stored: NDArray[Any]) -> NDArray[np.float64]:
    """Weights in float64 from stored weights; integers are divided by the maximum of their type."""
    steps = np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1
    return np.asarray(stored / np.float64(steps))
