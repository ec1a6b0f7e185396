"""UVs and normals at triangle corners: vertices split for them, and normals of another pose."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..surface import Surface

_UP = np.array([0.0, 1.0, 0.0])


def unit(
    vectors: NDArray[np.floating], fallback: NDArray[np.floating] = _UP, least: float = 1e-300
) -> NDArray[np.float64]:
    """Vectors ``(..., 3)`` scaled to length 1; `fallback` where their length is up to `least`."""
    length = np.linalg.norm(np.asarray(vectors, dtype=np.float64), axis=-1, keepdims=True)
    found = length > least
    return np.asarray(np.where(found, vectors / np.where(found, length, 1.0), fallback))


@dataclasses.dataclass(frozen=True, eq=False)
class Corners:
    """Mesh whose vertices are split so that each has one UV and one normal.

    The first V of its N vertices are the model's own in their order. After them come the copies
    that seams and hard edges need.

    Attributes
    ----------
    vertex : (N,) int32
        The model's vertex at each vertex of this mesh.
    faces : (T, 3) int32
    uv : (N, 2) float32 or None
    normals : (N, 3) float32 or None
    """

    vertex: NDArray[np.int32]
    faces: NDArray[np.int32]
    uv: NDArray[np.float32] | None
    normals: NDArray[np.float32] | None


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


def corner_normals(
    rest: NDArray[np.floating], faces: NDArray[np.integer], surface: Surface | None
) -> NDArray[np.float32]:
    """Normals ``(T, 3, 3)`` at triangle corners of a pose, hard where those of `surface` are.

    Each is the mean of the normals of the triangles around a vertex, weighted by their angles
    there. The mean is over the corners at which `surface` has equal normals, or over all corners of
    the vertex if it has no normals.

    References
    ----------
    Thürmer & Wüthrich, "Computing vertex normals from polygonal facets", 1998.
    """
    if not len(faces):
        return np.zeros((0, 3, 3), dtype=np.float32)
    p = rest.astype(np.float64)[faces]
    face = unit(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]))
    group: NDArray[np.integer] = faces.reshape(-1)
    if surface is not None and surface.normals is not None:
        key = np.concatenate(
            [group[:, None], np.rint(surface.normals.reshape(-1, 3) * 1e3)], axis=1
        )
        group = np.unique(key.astype(np.int64), axis=0, return_inverse=True)[1].reshape(-1)
    sums = _sums(face[:, None] * _angles(p)[..., None], group)
    return unit(sums[group], np.repeat(face, 3, axis=0)).reshape(-1, 3, 3).astype(np.float32)


@dataclasses.dataclass(frozen=True, eq=False)
class Deformation:
    """A mesh in two poses, which carries normals and tangents from the first to the second.

    Attributes
    ----------
    holder : (T, 3) int array
        Index of the normal or tangent at each corner.
    faces : (T, 3) int array
    source, target : (V, 3) float64 arrays
        Vertices in the first and the second pose.
    """

    holder: NDArray[np.integer]
    faces: NDArray[np.integer]
    source: NDArray[np.float64]
    target: NDArray[np.float64]

    def carry_normals(self, normals: NDArray[np.float64]) -> NDArray[np.float32]:
        """Unit normals ``(N, 3)`` in the target pose, from those in the source pose.

        Each triangle that has a normal at a corner transforms it by the cofactor matrix of the
        triangle's deformation. The result is the mean of these, weighted by the angles at the
        corners. So edges stay as smooth or hard as they were, and where the mesh moves rigidly,
        normals move with it. A normal stays unchanged if all its triangles are degenerate.
        """
        return self._carry(normals, cofactors=True).astype(np.float32)

    def carry_tangents(
        self, tangents: NDArray[np.float64], normals: NDArray[np.floating]
    ) -> NDArray[np.float32]:
        """Tangents ``(N, 4)`` in the target pose, perpendicular to `normals` of that pose.

        The signs in the last column stay.
        """
        moved = self._carry(tangents[:, :3], cofactors=False)
        flat = moved - (moved * normals).sum(axis=1, keepdims=True) * normals
        return np.concatenate([unit(flat, moved, 1e-6), tangents[:, 3:]], axis=1).astype(np.float32)

    def _carry(self, vectors: NDArray[np.float64], *, cofactors: bool) -> NDArray[np.float64]:
        before, usable = _triangle_frames(self.source[self.faces])
        after, also = _triangle_frames(self.target[self.faces])
        usable &= also
        before[~usable] = after[~usable] = np.eye(3)
        gradient = after @ np.linalg.inv(before)
        if cofactors:
            gradient = np.swapaxes(np.linalg.inv(gradient), -1, -2)
        moved = unit(np.einsum("tij,tcj->tci", gradient, vectors[self.holder]), np.zeros(3))
        moved *= (usable[:, None] * _angles(self.target[self.faces]))[..., None]
        return unit(_sums(moved, self.holder.reshape(-1), len(vectors)), vectors, 1e-9)


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
    """Angles ``(T, 3)`` at the corners of triangles, given the positions ``(T, 3, 3)`` of these."""
    toward, back = np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p
    cross = np.linalg.norm(np.cross(toward, back), axis=2)
    return np.asarray(np.arctan2(cross, (toward * back).sum(axis=2)))


def _sums(
    values: NDArray[np.float64], group: NDArray[np.integer], size: int = 0
) -> NDArray[np.float64]:
    """Sums ``(n, 3)`` of the vectors in each of n groups, at least `size` of them."""
    rows = values.reshape(-1, 3)
    return np.stack([np.bincount(group, rows[:, c], size) for c in range(3)], axis=1)
