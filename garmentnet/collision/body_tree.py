"""Trees of bounding boxes over triangles, and over those of a body in each pose."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssdr import Skinning, skin
from ssdr.kernels.closest import tree_order

from .crossing_kernels import fit_triangles

# Corners (T, 9) of the triangles, levels of the tree and boxes of its nodes.
Scene = tuple[NDArray[np.float64], int, NDArray[np.float64]]


def tree_of(
    points: ArrayLike, faces: NDArray[np.int32], leaf: int = 4
) -> tuple[NDArray[np.int32], int]:
    """Triangles ``(T, 3)`` sorted for a tree of bounding boxes, and the tree's depth.

    The tree is binary, as of :mod:`ssdr.kernels.closest`; a leaf has at most about `leaf`
    triangles.
    """
    depth = max(0, math.ceil(math.log2(max(1, len(faces)) / leaf)))
    order = tree_order(np.asarray(points, np.float64), faces, depth)
    return np.ascontiguousarray(faces[order], np.int32), depth


class BodyTree:
    """Tree of bounding boxes over a body's triangles, which is fitted to each pose.

    Parameters
    ----------
    body : Skinning
    """

    def __init__(self, body: Skinning) -> None:
        self.body = body
        self.triangles, self.depth = tree_of(body.rest, body.faces)
        self._every = np.ones(len(self.triangles), bool)

    def scenes(self, joints: NDArray[np.float64]) -> Iterator[Scene]:
        """Corners, depth and boxes of the body in each of the poses ``(F, J, 3, 4)``."""
        b = self.body
        for posed in skin(b.rest, b.indices, b.weights, joints, dtype=np.float64):
            boxes = np.empty((2 ** (self.depth + 1) - 1, 6))
            corners = np.empty((len(self.triangles), 9))
            fit_triangles(posed, self.triangles, self._every, self.depth, corners, boxes)
            yield corners, self.depth, boxes
