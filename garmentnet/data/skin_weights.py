"""Dense skin weights reduced to a few influences a vertex."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["strongest"]


def strongest(
    weights: NDArray[np.float64], count: int
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The strongest influences of every vertex, their weights scaled to sum 1.

    Parameters
    ----------
    weights : (V, B) array
        Dense, >= 0, no row all 0.
    count : int
        K, influences a vertex.

    Returns
    -------
    joints : (V, K) int32
        Strongest first; 0 where the weight is 0.
    weights : (V, K)

    Examples
    --------
    >>> joints, largest = strongest(np.array([[0.1, 0.6, 0.3]]), 2)
    >>> joints.tolist(), largest.round(3).tolist()
    ([[1, 2]], [[0.667, 0.333]])
    """
    order = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    largest: NDArray[np.float64] = np.take_along_axis(weights, order, axis=1)
    largest /= largest.sum(axis=1, keepdims=True)
    return np.where(largest > 0, order, 0).astype(np.int32), largest
