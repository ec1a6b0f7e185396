"""Trees of bounding boxes over triangles, and distances to a body in its poses."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssdr import Skinning, skin
from ssdr.common.checks import check_floats
from ssdr.common.parallel import chunk_bounds, run_chunks
from ssdr.kernels.closest import fit_boxes, tree_order

from .kernels import signed_distances

# Metres below the skin from which a vertex counts as inside.
INSIDE = 5e-4
_FRAMES = 8  # of a chunk
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

    def scenes(self, joints: NDArray[np.float64]) -> Iterator[Scene]:
        """Corners, depth and boxes of the body in each of the poses ``(F, J, 3, 4)``."""
        b = self.body
        for posed in skin(b.rest, b.indices, b.weights, joints, dtype=np.float64):
            boxes = np.empty((2 ** (self.depth + 1) - 1, 6))
            fit_boxes(posed, self.triangles, self.depth, boxes)
            yield posed.take(self.triangles, axis=0).reshape(-1, 9), self.depth, boxes

    def signed_distance(
        self, points: ArrayLike, joints: ArrayLike, *, limit: float = math.inf
    ) -> NDArray[np.float64]:
        """Signed distance ``(F, n)`` of points ``(F, n, 3)`` to the skin, metres, negative inside.

        It is infinite where a point is outside and farther than `limit`.  The sign is that of the
        winding number, as in Jacobson et al., "Robust inside-outside segmentation using generalized
        winding numbers", 2013, of a closed mesh, which is counted with a ray.

        Raises
        ------
        InputError
            If a shape does not match or a number is not finite.

        Examples
        --------
        >>> corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
        >>> body = Skinning(
        ...     corners, np.zeros((4, 1), int), np.ones((4, 1)), np.eye(3, 4)[None, None],
        ...     faces=[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        ... )
        >>> some = np.array([[[0.02, 0.2, 0.2], [-0.5, 0.2, 0.2]]])
        >>> BodyTree(body).signed_distance(some, body.transforms).tolist()
        [[-0.02, 0.5]]
        """
        v = check_floats(points, "points", ("F", "n", 3))
        shape = len(v), self.body.n_bones, 3, 4
        m = np.asarray(check_floats(joints, "joints", shape), np.float64)
        out = np.empty(v.shape[:2])

        def measure(_: int, start: int, stop: int) -> None:
            for t, scene in enumerate(self.scenes(m[start:stop]), start):
                own = np.ascontiguousarray(v[t], dtype=np.float64)
                signed_distances(own, scene, limit, out[t])

        run_chunks(measure, chunk_bounds(len(v), _FRAMES))
        return out


def is_closed(faces: ArrayLike) -> bool:
    """Whether triangles ``(T, 3)`` close a body, as distances need.

    In a closed mesh, as many triangles use an edge in one direction as in the other.

    Examples
    --------
    >>> is_closed([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]), is_closed([[0, 1, 2]])
    (True, False)
    """
    f = np.asarray(faces)
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
    there, back = (
        np.sort(e[:, 0].astype(np.int64) << 32 | e[:, 1]) for e in (edges, edges[:, ::-1])
    )
    return len(f) > 0 and np.array_equal(there, back)
