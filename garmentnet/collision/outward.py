"""Cloth moved out of the body on the side that faces outwards, so that limbs stay under it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssdr import Skinning
from ssdr.common.checks import check_faces, check_floats, check_mask
from ssdr.common.errors import InputError
from ssdr.common.parallel import chunk_bounds, run_chunks

from ..data.outfit import neighbours
from ..data.subject import Subject
from .body_tree import BodyTree, is_closed
from .crossings import DEEP
from .outward_kernels import push_outward

# Distance from the skin, metres.
_MARGIN = 4e-3
_SWEEPS = 8  # edges over which a displacement spreads
_ROUNDS = 8  # most repetitions
_FRAMES = 8  # of a chunk
# The farthest skin to which a vertex is moved, metres: more than half a thigh.
_REACH = 0.12


@dataclasses.dataclass(frozen=True, eq=False)
class PushedOut:
    """Garment whose vertices were moved out of the body.

    Attributes
    ----------
    vertices : (F, V, 3) array
        Metres, with the dtype of the input.
    distance : (F, V) float64
        How far each vertex was moved, metres.
    """

    vertices: NDArray[np.floating]
    distance: NDArray[np.float64]

    @property
    def moved(self) -> float:
        """Fraction of the vertices that were moved by more than 5 mm, over all frames."""
        return float((self.distance > DEEP).mean())

    @property
    def farthest(self) -> float:
        """Largest displacement of a vertex, metres."""
        return float(self.distance.max(initial=0.0))


class OutwardPush:
    """Push-out of one garment from one body, by which no limb ends up before the cloth.

    A body is worn under a garment.  So a vertex inside the body, or behind a limb that an edge of
    the cloth passes through, goes to the nearest skin that faces as the cloth around it does,
    although skin that faces the other way may be nearer (but not five times as near, as where an
    arm presses on the cloth from outside).  Corners of the body that stick out
    between vertices lift the triangle before them.  Displacements are spread over the cloth, and
    all is repeated until nothing crosses, or no fewer triangles do.

    Where nothing crosses, nothing is moved.  Each frame is treated by itself: the result does not
    depend on what was before it.

    Parameters
    ----------
    body : Skinning
        A body whose mesh is closed, with triangles that face outwards.
    faces : (T, 3) int array
        Triangles of the garment, which face outwards, too.
    n_vertices : int
        Number of vertices V of the garment.
    pinned : (V,) bool array, optional
        Vertices that stay where they are; none by default.

    Raises
    ------
    InputError
        If the body is not closed or an argument is not usable.

    Examples
    --------
    A sheet that lies 0.3 m below the upper side of a cube, and 0.1 m above its lower one:

    >>> corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-0.4, 0)], float)
    >>> quads = (0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)
    >>> body = Skinning(
    ...     corners, np.zeros((8, 1), int), np.ones((8, 1)), np.eye(3, 4)[None, None],
    ...     faces=[t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))],
    ... )
    >>> sheet = np.array([[[-2, 0, -0.02], [2, -2, -0.02], [2, 2, -0.02], [0, 0, -0.05]]])
    >>> faces = [[0, 1, 3], [1, 2, 3], [2, 0, 3]]
    >>> out = OutwardPush(body, faces, 4)(sheet, body.transforms)
    >>> bool(out.vertices[0, 3, 2] > 0)
    True
    """

    def __init__(
        self,
        body: Skinning,
        faces: ArrayLike,
        n_vertices: int,
        *,
        pinned: ArrayLike | None = None,
    ) -> None:
        if not is_closed(body.faces):
            expected = "a closed mesh with triangles that face one way"
            raise InputError("body", expected, "an open one")
        self.n_vertices, self._tree = n_vertices, BodyTree(body)
        self.fixed = check_mask(pinned, "pinned", n_vertices)
        # A copy: the kernel is compiled once more for arrays that cannot be written.
        every = np.array(check_faces(faces, self.n_vertices), np.int32, order="C")
        cloth = every[~self.fixed[every].all(axis=1)]
        n, (starts, others) = self.n_vertices, neighbours(every, self.n_vertices)
        sources = np.repeat(np.arange(n), np.diff(starts))
        keys = np.minimum(sources, others) * n + np.maximum(sources, others)
        known, numbers = np.unique(keys, return_inverse=True)
        ends = cloth.astype(np.int64), np.roll(cloth, -1, axis=1)
        edges = np.searchsorted(known, np.minimum(*ends) * n + np.maximum(*ends))
        of_vertex = np.argsort(every.ravel(), kind="stable")
        firsts = np.searchsorted(every.ravel()[of_vertex], np.arange(n + 1))
        self._garment: tuple[Any, ...] = (
            cloth,
            edges.astype(np.int32),
            self.fixed,
            starts,
            others,
            numbers.reshape(-1).astype(np.int32),
            firsts.astype(np.int32),
            (of_vertex // 3).astype(np.int32),
            every,
        )

    def __call__(self, vertices: ArrayLike, joints: ArrayLike) -> PushedOut:
        """Move a garment out of the body.

        Parameters
        ----------
        vertices : (F, V, 3) array
            Positions of the garment, metres.
        joints : (F, J, 3, 4) array
            World transforms of the body's joints from its rest pose.

        Raises
        ------
        InputError
            If a shape does not match or a number is not finite.
        """
        v = check_floats(vertices, "vertices", ("F", self.n_vertices, 3))
        shape = len(v), self._tree.body.n_bones, 3, 4
        m = np.asarray(check_floats(joints, "joints", shape), np.float64)
        out, distance = np.empty_like(v), np.empty(v.shape[:2])

        def push(_: int, start: int, stop: int) -> None:
            for t, scene in enumerate(self._tree.scenes(m[start:stop]), start):
                points = np.array(v[t], np.float64, order="C")
                push_outward(points, self._garment, scene, _MARGIN, _REACH, _SWEEPS, _ROUNDS)
                out[t] = points
                distance[t] = np.sqrt(((points - v[t]) ** 2).sum(axis=1))

        run_chunks(push, chunk_bounds(len(v), _FRAMES))
        return PushedOut(out, distance)


def push_of(subject: Subject) -> OutwardPush | None:
    """What moves a garment out of its body; None without a closed mesh of the body."""
    if not is_closed(subject.body.faces):
        return None
    g = subject.garment
    return OutwardPush(subject.body, g.faces, g.n_vertices, pinned=subject.carried)
