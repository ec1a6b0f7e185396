"""UVs, normals and tangents for files: vertices split where they differ, and change of pose."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..mesh.normals import corner_normals, unit
from ..model.skinning import Skinning

_UP = np.array([0.0, 1.0, 0.0])  # normal of a vertex without triangles


@dataclasses.dataclass(frozen=True, eq=False)
class Corners:
    """Mesh whose vertices are split so that each has one UV and one normal.

    The first V of its N vertices are the model's own in their order. After them come the copies
    that seams and hard edges need.

    Attributes
    ----------
    vertex : (N,) int32
        Model vertex index of each vertex of this mesh.
    faces : (T, 3) int32
    uv : (N, 2) float32 or None
    normals : (N, 3) float32 or None
    number : (N,) int32 or None
        For a model with shapes: index of each vertex's normal among the model's normals.
    """

    vertex: NDArray[np.int32]
    faces: NDArray[np.int32]
    uv: NDArray[np.float32] | None
    normals: NDArray[np.float32] | None
    number: NDArray[np.int32] | None = None


def split_corners(
    faces: NDArray[np.int32],
    n_vertices: int,
    uv: NDArray[np.float32] | None,
    normals: NDArray[np.float32] | None,
) -> Corners:
    """Mesh with one vertex for each different (vertex, UV, normal) at the triangle corners."""
    flat = faces.reshape(-1).astype(np.int64)
    columns = [flat[:, None]]
    for values in (uv, normals):
        if values is not None:
            plain = np.ascontiguousarray(values.reshape(len(flat), values.shape[-1]), np.float32)
            # 0 is added so that -0 has the bits of 0
            columns.append((plain + np.float32(0)).view(np.int32).astype(np.int64))
    _, first, inverse = np.unique(
        np.concatenate(columns, axis=1), axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first, kind="stable")
    vertices = flat[first[order]]
    copy = np.ones(len(order), dtype=bool)
    copy[np.unique(vertices, return_index=True)[1]] = False
    label = np.empty(len(order), dtype=np.int64)
    label[order] = np.where(copy, n_vertices - 1 + np.cumsum(copy), vertices)
    vertex = np.concatenate([np.arange(n_vertices), vertices[copy]]).astype(np.int32)
    split = label[inverse.reshape(-1)]

    def spread(values: NDArray[np.float32] | None, unused: NDArray[Any]) -> Any:
        if values is None:
            return None
        result = np.tile(unused.astype(np.float32), (len(vertex), 1))
        result[split] = values.reshape(-1, len(unused))
        return result

    triangles = split.reshape(-1, 3).astype(np.int32)
    return Corners(vertex, triangles, spread(uv, np.zeros(2)), spread(normals, _UP))


def rest_normals(model: Skinning, rest: NDArray[np.floating]) -> NDArray[np.float32] | None:
    """Normals ``(T, 3, 3)`` to write for a model: its own if it has any, else those of `rest`.

    None if there are no triangles.
    """
    if not len(model.faces):
        return None
    own = None if model.surface is None else model.surface.normals
    return corner_normals(rest, model.faces, None) if own is None else own


def carry_tangents(
    tangents: NDArray[np.float64],
    normals: NDArray[np.floating],
    faces: NDArray[np.integer],
    source: NDArray[np.float64],
    target: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Tangents ``(V, 4)`` of a mesh that is deformed from one pose to another.

    Each triangle transforms the tangents at its corners by its own deformation.  The mean at a
    vertex, weighted by the angles at the corners, is made perpendicular to the normal.  So edges
    stay as smooth or hard as they were, and where the mesh moves rigidly, tangents move with it.
    If all its triangles are degenerate, a tangent is only made perpendicular.  The signs in the
    last column stay.

    Parameters
    ----------
    tangents : (V, 4) array
        In the source pose.
    normals : (V, 3) array
        In the target pose.
    faces : (T, 3) int array
    source, target : (V, 3) float64 arrays
        Vertices in the first and the second pose.
    """
    before, usable = _triangle_frames(source[faces])
    after, also = _triangle_frames(target[faces])
    usable &= also
    before[~usable] = after[~usable] = np.eye(3)
    gradient = after @ np.linalg.inv(before)
    moved = unit(np.einsum("tij,tcj->tci", gradient, tangents[faces, :3]), np.zeros(3))
    moved *= (usable[:, None] * _angles(target[faces]))[..., None]
    sums = np.zeros((len(tangents), 3))
    np.add.at(sums, faces.reshape(-1), moved.reshape(-1, 3))
    moved = unit(sums, tangents[:, :3], 1e-9)
    flat = moved - (moved * normals).sum(axis=1, keepdims=True) * normals
    return np.concatenate([unit(flat, moved, 1e-6), tangents[:, 3:]], axis=1).astype(np.float32)


def _triangle_frames(p: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Matrix (T, 3, 3) with two edges and the unit normal as columns, and a mask (T,).

    The mask is false for triangles without area.
    """
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    normal = np.cross(a, b)
    size = np.maximum((a**2).sum(axis=1), (b**2).sum(axis=1))
    usable = np.linalg.norm(normal, axis=1) > np.maximum(1e-9 * size, 1e-300)
    return np.stack([a, b, unit(normal, np.zeros(3))], axis=2), usable


def _angles(p: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles ``(T, 3)`` at the corners of triangles with the corner positions ``(T, 3, 3)``."""
    toward, back = np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p
    cross = np.linalg.norm(np.cross(toward, back), axis=2)
    return np.asarray(np.arctan2(cross, (toward * back).sum(axis=2)))
