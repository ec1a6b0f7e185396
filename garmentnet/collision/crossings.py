"""Crossings of a garment with its body: limbs that have passed through the cloth."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssdr import Skinning
from ssdr.common.checks import check_faces, check_mask
from ssdr.common.parallel import chunk_bounds, run_chunks

from .body_tree import BodyTree
from .crossing_kernels import count_crossings

# Metres from which a crossing can be seen: edges of a coarse mesh graze a body without harm.
DEEP = 5e-3
_FRAMES = 8


@dataclasses.dataclass(frozen=True, eq=False)
class Crossings:
    """Crossings of triangles of a garment with triangles of its body, frame by frame.

    Attributes
    ----------
    pairs : (F,) int64
        Pairs of triangles, one of each mesh, that cross.
    depth : (F,) float64
        Depth of the deepest crossing, metres: how far the nearer end of an edge of one triangle
        lies beyond the plane of the other, which the edge crosses.  A limb that has passed through
        the cloth altogether is at least as deep as its mesh is fine.
    """

    pairs: NDArray[np.int64]
    depth: NDArray[np.float64]

    @property
    def any(self) -> float:
        """Fraction of the frames in which something crosses."""
        return float((self.pairs > 0).mean())

    @property
    def deep(self) -> float:
        """Fraction of the frames in which something crosses by more than 5 mm."""
        return float((self.depth > DEEP).mean())


def find_crossings(
    body: Skinning,
    faces: ArrayLike,
    vertices: ArrayLike,
    joints: ArrayLike,
    *,
    pinned: ArrayLike | None = None,
) -> Crossings:
    """Find where a garment crosses its body.

    Unlike the depth of vertices inside the body it sees a limb that has passed through the cloth
    between its vertices, or so far that all of them are outside again.

    Parameters
    ----------
    body : Skinning
    faces : (T, 3) int array
        Triangles of the garment.
    vertices : (F, V, 3) array
        Positions of the garment, metres.
    joints : (F, J, 3, 4) array
        World transforms of the body's joints from its rest pose.
    pinned : (V,) bool array, optional
        Vertices that follow the body; triangles of which all corners do are left out.

    Examples
    --------
    A triangle of cloth, 0.2 m before a tetrahedron's tip and then 0.01 m behind it:

    >>> corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    >>> body = Skinning(
    ...     corners, np.zeros((4, 1), int), np.ones((4, 1)), np.eye(3, 4)[None, None],
    ...     faces=[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    ... )
    >>> cloth = np.array([[-1, -1, 1.2], [1, -1, 1.2], [0, 2, 1.2]])
    >>> found = find_crossings(
    ...     body, [[0, 1, 2]], [cloth, cloth - [0, 0, 0.21]], np.eye(3, 4)[None, None].repeat(2, 0)
    ... )
    >>> found.pairs.tolist(), found.depth.round(6).tolist(), found.any, found.deep
    ([0, 3], [0.0, 0.01], 0.5, 0.5)
    """
    v, m = np.asarray(vertices, np.float64), np.asarray(joints, np.float64)
    cloth = check_faces(faces, v.shape[1])
    cloth = cloth[~check_mask(pinned, "pinned", v.shape[1])[cloth].all(axis=1)]
    tree = BodyTree(body)
    pairs, deepest = np.zeros(len(v), np.int64), np.zeros(len(v))

    def measure(_: int, start: int, stop: int) -> None:
        for t, scene in enumerate(tree.scenes(m[start:stop]), start):
            own = v[t].take(cloth, axis=0).reshape(-1, 9)
            pairs[t], deepest[t] = count_crossings(own, *scene)

    if len(cloth) and len(tree.triangles):
        run_chunks(measure, chunk_bounds(len(v), _FRAMES))
    return Crossings(pairs, deepest)
