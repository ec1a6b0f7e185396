"""Ends of bones as programs draw them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .transforms import parents_first, rest_diagonal

Array = NDArray[np.float64]
_SHORTEST = 0.01  # least length, in diagonals of the mesh: programs drop bones without length
# If the mean of the children's joints is nearer to a joint than this part of their mean distance,
# they lie around it on all sides.
_FORKED = 0.3


def limb_ends(
    positions: NDArray[np.floating],
    parents: NDArray[np.integer],
    rest: NDArray[np.floating],
    indices: NDArray[np.integer],
    weights: NDArray[np.floating],
) -> Array:
    """Ends (B, 3) of all bones in the rest pose.

    A bone with one child ends at the child's joint.  A bone with several children ends at the mean
    of their joints or, if these lie around the bone's own joint on all sides, at the joint of the
    child with the longest chain.  A bone without children extends as far as the vertices of which
    it is the strongest influence.

    Parameters
    ----------
    positions : (B, 3) array
        Joints in the rest pose.
    parents : (B,) int array
    rest : (V, 3) array
    indices, weights : (V, K) arrays
    """
    at = np.asarray(positions, dtype=np.float64)
    shortest = _SHORTEST * (rest_diagonal(rest) or 1.0)
    n_bones = len(at)
    height = np.zeros(n_bones, dtype=np.int64)  # bones on the longest chain below
    order = parents_first(parents)
    for b in order[::-1]:
        if parents[b] >= 0:
            height[parents[b]] = max(height[parents[b]], height[b] + 1)
    rows = np.arange(len(rest))
    most = np.asarray(indices)[rows, np.argmax(weights, axis=1)]
    ends = np.full((n_bones, 3), np.nan)
    for b in order:
        way = np.zeros(3)
        below = np.flatnonzero(np.asarray(parents) == b)
        if len(below):
            ways = at[below] - at[b]
            way = ways.mean(axis=0)
            if np.linalg.norm(way) < _FORKED * np.linalg.norm(ways, axis=1).mean():
                way = ways[np.lexsort((np.linalg.norm(ways, axis=1), height[below]))[-1]]
        if np.linalg.norm(way) < shortest:
            way = _reach(np.asarray(rest, dtype=np.float64)[most == b] - at[b])
        if np.linalg.norm(way) < shortest and parents[b] >= 0:
            way = 0.5 * (ends[parents[b]] - at[parents[b]])
        length = float(np.linalg.norm(way))
        if length < shortest:
            way = np.array([0.0, shortest, 0.0]) if not length else way * (shortest / length)
        ends[b] = at[b] + way
    return ends


def _reach(points: Array) -> Array:
    """Vector from the origin towards the mean of the points.

    Its length is the 98 % quantile of the points' coordinates in that direction.
    """
    if not len(points):
        return np.zeros(3)
    middle = points.mean(axis=0)
    length = float(np.linalg.norm(middle))
    far = max(float(np.quantile(points @ middle, 0.98)), 0.0)
    return np.asarray(middle * (far / (length**2 or 1.0)))
