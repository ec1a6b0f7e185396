"""UVs and normals at the corners of triangles: splitting vertices, normals of a rest pose."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..sequence import Surface

__all__ = ["Corners", "corner_normals", "split_corners"]


@dataclasses.dataclass(frozen=True, eq=False)
class Corners:
    """Vertices of a format that has one UV and normal a vertex.

    The first V of the N are the model's own vertices in their order; behind
    them stand the copies that seams and hard edges need.

    Attributes
    ----------
    vertex : (N,) int32
        The model's vertex.
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
    """One vertex for each different (vertex, uv, normal) of the triangles' corners."""
    flat = faces.reshape(-1).astype(np.int64)
    columns = [flat[:, None]]
    for values in (uv, normals):
        if values is not None:
            plain = np.ascontiguousarray(values, dtype=np.float32).reshape(len(flat), -1)
            columns.append((plain + np.float32(0)).view(np.int32).astype(np.int64))
    _, first, inverse = np.unique(
        np.concatenate(columns, axis=1), axis=0, return_index=True, return_inverse=True
    )
    inverse = inverse.reshape(-1)
    order = np.argsort(first, kind="stable")
    vertices = flat[first[order]]
    _, head = np.unique(vertices, return_index=True)
    extra = np.ones(len(order), dtype=bool)
    extra[head] = False
    label = np.empty(len(order), dtype=np.int64)
    label[order[head]] = vertices[head]
    label[order[extra]] = n_vertices + np.arange(int(extra.sum()))
    vertex = np.concatenate([np.arange(n_vertices), vertices[extra]]).astype(np.int32)
    split = label[inverse]
    uvs = new_normals = None
    if uv is not None:
        uvs = np.zeros((len(vertex), 2), dtype=np.float32)
        uvs[split] = uv.reshape(-1, 2)
    if normals is not None:
        new_normals = np.tile(np.array([0, 1, 0], dtype=np.float32), (len(vertex), 1))
        new_normals[split] = normals.reshape(-1, 3)
    return Corners(vertex, split.reshape(-1, 3).astype(np.int32), uvs, new_normals)


def corner_normals(
    rest: NDArray[np.floating], faces: NDArray[np.int32], surface: Surface | None
) -> NDArray[np.float32]:
    """Normals ``(T, 3, 3)`` of a rest pose, with the hard edges of the input.

    The mean of the normals of the triangles around a vertex, weighted by their
    angle there, over those corners whose input normals were equal (all of them
    without input normals).

    References
    ----------
    Thürmer & Wüthrich, "Computing vertex normals from polygonal facets", 1998.
    """
    if not len(faces):
        return np.zeros((0, 3, 3), dtype=np.float32)
    p = rest.astype(np.float64)[faces]
    toward = np.roll(p, -1, axis=1) - p
    back = np.roll(p, 1, axis=1) - p
    cross = np.cross(toward, back)
    angle = np.arctan2(np.linalg.norm(cross, axis=2), (toward * back).sum(axis=2))
    face = _unit(cross[:, 0], np.array([0.0, 1.0, 0.0]))
    if surface is None or surface.normals is None:
        group = faces.reshape(-1).astype(np.int64)
    else:
        key = np.concatenate(
            [faces.reshape(-1, 1), np.rint(surface.normals.reshape(-1, 3) * 1e3)], axis=1
        )
        found = np.unique(key.astype(np.int64), axis=0, return_inverse=True)[1]
        group = found.reshape(-1).astype(np.int64)
    share = (face[:, None] * angle[..., None]).reshape(-1, 3)
    sums = np.stack([np.bincount(group, share[:, c]) for c in range(3)], axis=1)
    smooth = _unit(sums[group].astype(np.float64), np.repeat(face, 3, axis=0))
    return smooth.reshape(-1, 3, 3).astype(np.float32)


def _unit(vectors: NDArray[np.float64], fallback: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    found = length > 1e-300
    return np.asarray(np.where(found, vectors / np.where(found, length, 1.0), fallback))
