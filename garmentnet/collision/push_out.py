"""Vertices of a predicted garment moved out of the body.

A network that was trained to keep vertices outside the body fails to do so now and then.  Each
vertex inside the posed body, or nearer to the skin than a margin, gets the shortest displacement
out of it.  Jacobi sweeps spread these displacements over the cloth around, so that edges are not
stretched, and a last step moves out the vertices that are inside after that.  No vertex ends deeper
inside than it was.

Where two parts of the body overlap, a vertex goes to the nearest point of the skin that no other
part covers; if there is none within reach, it stays.

The shortest way may lead behind a limb.  :mod:`garmentnet.collision.outward` chooses the side.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ssdr import Skinning
from ssdr.common.checks import check_faces, check_mask, check_whole
from ssdr.common.errors import InputError, is_real
from ssdr.common.parallel import chunk_bounds, run_chunks

from ..data.outfit import neighbours
from ..data.skeleton import check_finite
from .body_tree import BodyTree, Scene
from .kernels import push_frame, signed_distances

# Metres below the skin from which a vertex counts as inside, as for simulated clips.
INSIDE = 5e-4
# Distance from the skin, metres, which the simulated cloth of the data sets keeps, too.
MARGIN = 4e-3
# Farthest that a vertex is moved, metres, if the skin nearest to it is covered by another limb.
_FARTHEST = 0.02
_FRAMES = 8  # frames of a chunk; its searches start from the triangles of the frame before


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
        """Fraction of the vertices that were moved, over all frames."""
        return float((self.distance > 0).mean())

    @property
    def farthest(self) -> float:
        """Largest displacement of a vertex, metres."""
        return float(self.distance.max(initial=0.0))


class PushOut:
    """Push-out of one garment from one body.

    Parameters
    ----------
    body : Skinning
        A body whose mesh is closed, with triangles that face outwards.
    faces : (T, 3) int array
        Triangles of the garment.
    margin : float
        Height above the skin, metres, to which vertices are moved; those above it need not move.
    pinned : (V,) bool array, optional
        Vertices that stay where they are; none by default.
    sweeps : int
        Number of edges over which a displacement spreads.  With 0 single vertices are moved, which
        makes spikes.
    n_vertices : int, optional
        Number of vertices of the garment, needed if the last ones are in no triangle.

    Raises
    ------
    InputError
        If the body is not closed or an argument is not usable.

    References
    ----------
    The closest point on a triangle: Ericson, "Real-Time Collision Detection", 2005, section
    5.1.5.  The sign is that of the winding number, as in Jacobson et al., "Robust inside-outside
    segmentation using generalized winding numbers", 2013; for a closed mesh it is counted with a
    ray.  The sign of the nearest normal (Baerentzen & Aanaes 2005) is wrong where limbs overlap.

    Examples
    --------
    >>> corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    >>> body = Skinning(
    ...     corners, np.zeros((4, 1), int), np.ones((4, 1)), np.eye(3, 4)[None, None],
    ...     faces=[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    ... )
    >>> cloth = np.array([[[0.02, 0.2, 0.2], [-0.5, 0.2, 0.2], [-0.5, 0.3, 0.2]]])
    >>> out = PushOut(body, [[0, 1, 2]], margin=0.01, sweeps=0)(cloth, body.transforms)
    >>> out.vertices[0, 0].round(6).tolist(), round(out.farthest, 6)
    ([-0.01, 0.2, 0.2], 0.03)
    """

    def __init__(
        self,
        body: Skinning,
        faces: ArrayLike,
        *,
        margin: float = MARGIN,
        pinned: ArrayLike | None = None,
        sweeps: int = 6,
        n_vertices: int | None = None,
    ) -> None:
        if not is_real(margin) or margin <= 0:
            raise InputError("margin", "a positive number of metres", repr(margin))
        count = int(np.max(faces, initial=-1)) + 1 if n_vertices is None else n_vertices
        triangles = check_faces(faces, count)
        fixed = check_mask(pinned, "pinned", count)
        self.n_vertices, self.fixed = count, np.zeros(count, bool) if fixed is None else fixed
        if not is_closed(body.faces):
            expected = "a closed mesh with triangles that face one way"
            raise InputError("body", expected, "an open one")
        self._tree, self.margin = BodyTree(body), float(margin)
        self.sweeps = check_whole(sweeps, "sweeps", 0)
        # Where the neighbours of each vertex begin, and all of them.
        self._near = neighbours(triangles, count)

    def __call__(self, vertices: ArrayLike, joints: ArrayLike) -> PushedOut:
        """Move the vertices that are inside the body out of it.

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

        Notes
        -----
        Frames do not depend on each other: the result is the same for any number of threads.
        """
        v, m = self._checked(vertices, joints)
        frames, count = v.shape[:2]
        out = np.empty_like(v)
        distance = np.empty((frames, count))

        def push(_: int, start: int, stop: int) -> None:
            hints = np.full(count, -1, np.int32)
            for t, scene in enumerate(self._tree.scenes(m[start:stop]), start):
                points = np.ascontiguousarray(v[t], dtype=np.float64)
                out[t] = moved = self._pushed(points, scene, hints)
                distance[t] = np.sqrt(((moved - points) ** 2).sum(axis=1))

        run_chunks(push, chunk_bounds(frames, _FRAMES))
        return PushedOut(out, distance)

    def _pushed(
        self, points: NDArray[np.float64], scene: Scene, hints: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        moved, limits = np.empty_like(points), (self.margin, _FARTHEST)
        push_frame(points, self.fixed, *self._near, self.sweeps, *limits, scene, hints, moved)
        return moved

    def signed_distance(
        self, vertices: ArrayLike, joints: ArrayLike, *, limit: float = math.inf
    ) -> NDArray[np.float64]:
        """Signed distance ``(F, V)`` to the skin, metres, negative inside.

        It is infinite where a vertex is outside and farther than `limit`.  The arguments are those
        of a call, but the vertices may be any points, and pinned ones are measured, too.
        """
        v, m = self._checked(vertices, joints, any_count=True)
        out = np.empty(v.shape[:2])

        def measure(_: int, start: int, stop: int) -> None:
            for t, scene in enumerate(self._tree.scenes(m[start:stop]), start):
                points = np.ascontiguousarray(v[t], dtype=np.float64)
                signed_distances(points, scene, limit, out[t])

        run_chunks(measure, chunk_bounds(len(v), _FRAMES))
        return out

    def _checked(
        self, vertices: ArrayLike, joints: ArrayLike, *, any_count: bool = False
    ) -> tuple[NDArray[np.floating], NDArray[np.float64]]:
        v = np.asarray(vertices)
        if v.dtype.kind != "f":
            v = v.astype(np.float64)
        fits = v.ndim == 3 and v.shape[2] == 3 and (any_count or v.shape[1] == self.n_vertices)
        if not fits:
            raise InputError("vertices", f"shape (F, {self.n_vertices}, 3)", f"shape {v.shape}")
        m = np.asarray(joints, np.float64)
        shape = (len(v), self._tree.body.n_bones, 3, 4)
        if m.shape != shape:
            raise InputError("joints", f"shape {shape}", f"shape {m.shape}")
        check_finite(v, "vertices")
        check_finite(m, "joints")
        return v, m


def is_closed(faces: ArrayLike) -> bool:
    """Whether triangles ``(T, 3)`` close a body, as :class:`PushOut` needs.

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
