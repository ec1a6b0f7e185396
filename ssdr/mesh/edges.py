"""Edges of triangle meshes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def triangle_edges(faces: NDArray[np.integer], n: int) -> NDArray[np.int64]:
    """Edges (E, 2) of triangles (T, 3) over n vertices, as :func:`distinct_pairs` orders them."""
    return distinct_pairs(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), n)


def distinct_pairs(ends: NDArray[np.integer], n: int) -> NDArray[np.int64]:
    """Distinct pairs (P, 2) i < j among index pairs `ends` of n vertices, in ascending order."""
    i, j = np.sort(ends, axis=1).astype(np.int64).T
    code = np.unique((i * n + j)[i < j])
    return np.stack([code // n, code % n], axis=1)
