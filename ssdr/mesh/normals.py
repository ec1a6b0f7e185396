"""Normals of a surface: one for each vertex, or several where edges at the vertex are hard."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..common.parallel import chunk_bounds, run_chunks
from ..kernels.normals import normals_range
from .surface import Surface

Array = NDArray[np.float64]

_CHUNK = 16384  # triangles in a task
_UP = np.array([0.0, 1.0, 0.0])


@dataclasses.dataclass(frozen=True, eq=False)
class NormalHolders:
    """The N normals of a mesh, each of which some triangle corners at a vertex share.

    Attributes
    ----------
    faces : (T, 3) int32
        Triangles.
    corner : (T, 3) int32
        Index of the normal at each triangle corner.
    vertex : (N,) int32
        Vertex of each normal.
    group : (N,) int32
        Index of the first normal that equals this one in every frame, as on both sides of a UV
        seam.
    """

    faces: NDArray[np.int32]
    corner: NDArray[np.int32]
    vertex: NDArray[np.int32]
    group: NDArray[np.int32]


def normal_holders(
    faces: NDArray[np.integer],
    n_vertices: int,
    surface: Surface | None,
    places: NDArray[np.floating] | None = None,
) -> NormalHolders:
    """Normals of a mesh: one for each distinct normal that `surface` has at a vertex.

    Without normals in `surface` there is one for each vertex.

    Parameters
    ----------
    faces : (T, 3) int array
    n_vertices : int
    surface : Surface or None
    places : (V, C) array, optional
        Coordinates of each vertex in some frames.  Vertices with equal coordinates are copies of
        one vertex; their normals form a group where `surface` has equal normals.
    """
    triangles = np.ascontiguousarray(faces, dtype=np.int32)
    if surface is None or surface.normals is None:
        every = np.arange(n_vertices, dtype=np.int32)
        return NormalHolders(triangles, triangles, every, every)
    rounded = np.rint(surface.normals.reshape(-1, 3) * 1e3).astype(np.int64)
    key = np.concatenate([triangles.reshape(-1, 1), rounded], axis=1)
    found, index = np.unique(key, axis=0, return_inverse=True)
    corner = index.reshape(-1, 3).astype(np.int32)
    vertex, group = found[:, 0], np.arange(len(found))
    if places is not None:
        # 0 is added so that -0 has the bits of 0
        bits = (np.asarray(places, dtype=np.float64)[vertex] + 0.0).view(np.int64)
        key = np.concatenate([bits, found[:, 1:]], axis=1)
        _, first, index = np.unique(key, axis=0, return_index=True, return_inverse=True)
        group = first[index.reshape(-1)]
    return NormalHolders(triangles, corner, vertex.astype(np.int32), group.astype(np.int32))


def surface_normals(frames: NDArray[np.floating], holders: NormalHolders) -> Array:
    """Unit normals ``(F, N, 3)`` of a surface in F frames ``(F, V, 3)``.

    Each is the mean of the normals of the triangles at its corners, weighted by the angles at these
    corners.  Triangles without area do not count.  A normal for which no triangle is left, or whose
    sum cancels, is unknown and 0.

    References
    ----------
    Thürmer & Wüthrich, "Computing vertex normals from polygonal facets", 1998.
    """
    points = np.ascontiguousarray(frames, dtype=np.float64)
    corner = holders.group[holders.corner]
    out = np.empty((len(points), len(holders.group), 3))

    def work(_: int, first: int, last: int) -> None:
        normals_range(points, holders.faces, corner, out, first, last)

    run_chunks(work, chunk_bounds(len(points), 1 + _CHUNK // max(1, len(holders.faces))))
    copies = np.flatnonzero(holders.group != np.arange(len(holders.group)))
    out[:, copies] = out[:, holders.group[copies]]
    return out


def corner_normals(
    points: NDArray[np.floating], faces: NDArray[np.integer], surface: Surface | None
) -> NDArray[np.float32]:
    """Normals ``(T, 3, 3)`` at triangle corners of a pose, with the hard edges of `surface`.

    They are computed by :func:`surface_normals`.  Where this gives none, a corner has the normal of
    its triangle or, if the triangle has no area, (0, 1, 0).
    """
    return normals_at_corners(points, normal_holders(faces, len(points), surface))


def normals_at_corners(points: NDArray[np.floating], holders: NormalHolders) -> NDArray[np.float32]:
    """Normals ``(T, 3, 3)`` at triangle corners of a pose; see :func:`corner_normals`."""
    normals: Array = surface_normals(points[None], holders)[0][holders.corner]
    unknown = ~normals.any(axis=2)
    if unknown.any():
        normals[unknown] = unit(triangle_normals(points, holders.faces))[np.nonzero(unknown)[0]]
    return normals.astype(np.float32)


def triangle_normals(points: NDArray[np.floating], faces: NDArray[np.int32]) -> Array:
    """Unit normals ``(T, 3)`` of triangles, 0 for those without area."""
    each = np.arange(len(faces), dtype=np.int32)
    alone = NormalHolders(faces, np.repeat(each, 3).reshape(-1, 3), each, each)
    return np.asarray(surface_normals(points[None], alone)[0])


def unit(
    vectors: NDArray[np.floating], fallback: NDArray[np.floating] = _UP, least: float = 1e-300
) -> Array:
    """Vectors ``(..., 3)`` scaled to norm 1, or `fallback` where the norm is at most `least`."""
    length = np.linalg.norm(np.asarray(vectors, dtype=np.float64), axis=-1, keepdims=True)
    found = length > least
    return np.asarray(np.where(found, vectors / np.where(found, length, 1.0), fallback))
