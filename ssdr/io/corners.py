"""UVs, normals and colours for files: vertices are split where they differ."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..mesh.normals import corner_normals
from ..model.skinning import Skinning

_UP = np.array([0.0, 1.0, 0.0])  # normal of a vertex without triangles


@dataclasses.dataclass(frozen=True, eq=False)
class Corners:
    """Mesh whose vertices are split so that each has one UV, one normal and one colour.

    The first V of its N vertices are the model's own in their order. After them come the copies
    that seams and hard edges need.

    Attributes
    ----------
    vertex : (N,) int32
        Model vertex index of each vertex of this mesh.
    faces : (T, 3) int32
    uv : (N, 2) float32 or None
    normals : (N, 3) float32 or None
    colors : (N, 4) float32 or None
    """

    vertex: NDArray[np.int32]
    faces: NDArray[np.int32]
    uv: NDArray[np.float32] | None
    normals: NDArray[np.float32] | None
    colors: NDArray[np.float32] | None = None


def split_corners(
    faces: NDArray[np.int32],
    n_vertices: int,
    uv: NDArray[np.float32] | None,
    normals: NDArray[np.float32] | None,
    colors: NDArray[np.float32] | None = None,
) -> Corners:
    """Mesh with a vertex for each different (vertex, UV, normal, colour) at triangle corners."""
    flat = faces.reshape(-1).astype(np.int64)
    columns = [flat[:, None]]
    for values in (uv, normals, colors):
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
    fillers = (uv, np.zeros(2)), (normals, _UP), (colors, np.ones(4))
    return Corners(vertex, triangles, *(spread(*one) for one in fillers))


def rest_normals(model: Skinning, rest: NDArray[np.floating]) -> NDArray[np.float32] | None:
    """Normals ``(T, 3, 3)`` to write for a model: its own if it has any, else those of `rest`.

    None if there are no triangles.
    """
    if not len(model.faces):
        return None
    own = None if model.surface is None else model.surface.normals
    return corner_normals(rest, model.faces, None) if own is None else own
