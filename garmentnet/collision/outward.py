"""Cloth moved out of the body on the side that faces outwards, so that limbs stay under it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssdr import Skinning
from ssdr.common.checks import check_faces, check_whole
from ssdr.common.errors import InputError

from ..data.subject import Subject
from .body_tree import Scene, tree_of
from .outward_kernels import push_outward
from .push_out import PushOut, is_closed

# The farthest skin to which a vertex is moved, metres: more than half a thigh.
_REACH = 0.12


class OutwardPush(PushOut):
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
    body, faces, pinned
        As of :class:`~garmentnet.collision.push_out.PushOut`; the triangles of the garment face
        outwards, too.
    rest : (V, 3) array
        The garment in some pose, in which neighbouring triangles are found.
    sweeps : int
        Number of edges over which a displacement spreads.
    rounds : int
        Most repetitions.

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
    >>> out = OutwardPush(body, faces, sheet[0], sweeps=0)(sheet, body.transforms)
    >>> bool(out.vertices[0, 3, 2] > 0)
    True
    """

    def __init__(
        self,
        body: Skinning,
        faces: ArrayLike,
        rest: ArrayLike,
        *,
        pinned: ArrayLike | None = None,
        sweeps: int = 8,
        rounds: int = 8,
    ) -> None:
        shape = np.asarray(rest, np.float64)
        super().__init__(body, faces, pinned=pinned, sweeps=sweeps, n_vertices=len(shape))
        self.rounds = check_whole(rounds, "rounds", 1)
        every = np.ascontiguousarray(check_faces(faces, self.n_vertices), np.int32)
        movable = every[~self.fixed[every].all(axis=1)]
        if not len(movable):
            raise InputError("pinned", "a triangle that can move", "all corners")
        cloth, depth = tree_of(shape, movable)
        n, (starts, others) = self.n_vertices, self._near
        sources = np.repeat(np.arange(n), np.diff(starts))
        keys = np.minimum(sources, others) * n + np.maximum(sources, others)
        known, numbers = np.unique(keys, return_inverse=True)
        ends = cloth.astype(np.int64), np.roll(cloth, -1, axis=1)
        edges = np.searchsorted(known, np.minimum(*ends) * n + np.maximum(*ends))
        of_vertex = np.argsort(every.ravel(), kind="stable")
        firsts = np.searchsorted(every.ravel()[of_vertex], np.arange(n + 1))
        self._garment: tuple[Any, ...] = (
            cloth,
            depth,
            edges.astype(np.int32),
            self.fixed,
            starts,
            others,
            numbers.reshape(-1).astype(np.int32),
            firsts.astype(np.int32),
            (of_vertex // 3).astype(np.int32),
            every,
        )

    def frame(self, vertices: ArrayLike, pose: ArrayLike) -> NDArray[np.float64]:
        """Positions ``(V, 3)`` of a garment ``(V, 3)`` moved out of the body in a pose (J, 3, 4).

        It does what a call does, for one frame and without checks.
        """
        (scene,) = self._tree.scenes(np.asarray(pose, np.float64)[None])
        points = np.array(vertices, np.float64, order="C")
        return self._pushed(points, scene, np.empty(0, np.int32))

    def _pushed(
        self, points: NDArray[np.float64], scene: Scene, hints: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        moved, reach = points.copy(), _REACH
        push_outward(moved, self._garment, scene, self.margin, reach, self.sweeps, self.rounds)
        return moved


def push_of(subject: Subject) -> OutwardPush | None:
    """What moves a garment out of its body; None without a closed mesh of the body."""
    if not is_closed(subject.body.faces):
        return None
    g = subject.garment
    return OutwardPush(subject.body, g.faces, g.rest, pinned=subject.carried)
