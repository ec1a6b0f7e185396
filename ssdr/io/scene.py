"""The meshes of a scene as one sequence or skinning: what glTF, USD and FBX have in common."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..clips import Clip, in_order, unique_names
from ..errors import InputError
from ..lbs import skin
from ..sequence import Material, Surface
from ..skinning import BoneModel, Skinning
from .budget import MOST_BYTES, afford
from .corners import corner_normals

__all__ = [
    "Bones",
    "SceneBudget",
    "ScenePart",
    "Shape",
    "bake",
    "check_kept",
    "join_faces",
    "join_skinning",
    "join_surface",
    "match_template",
    "part_starts",
]

Shape = NDArray[np.float64] | Callable[[int], NDArray[np.float64]]

_CHUNK_BYTES = 64 << 20  # bytes of float64 positions skinned at a time: more takes more memory


class SceneBudget:
    """Memory that a scene file may ask for in all: 1000 times its size, but at least 1 GiB.

    A scene states counts, frames and copies of meshes that need no data of their own, so a small
    file can ask for any amount of memory.

    Parameters
    ----------
    path : Path
    n_bytes : int
        Size of the file and of what it refers to.
    max_bytes : int, optional
        The caller's limit instead.
    """

    def __init__(self, path: Path, n_bytes: int, max_bytes: int | None = None) -> None:
        self.path, self.spent, self._fixed = path, 0.0, max_bytes
        self.most = 1 << 30 if max_bytes is None else max_bytes
        self.grow(n_bytes)

    def grow(self, n_bytes: int) -> None:
        """Allow more, for another file of that size."""
        if self._fixed is None:
            self.most = min(MOST_BYTES, max(self.most, 1000 * n_bytes))

    def spend(self, n_bytes: float, what: str) -> None:
        """Add memory that reading on takes; refuse what goes over the limit.

        Raises
        ------
        FormatError
            If it does; see :func:`~ssdr.io.budget.afford`.
        """
        self.spent += n_bytes
        afford(self.spent, what, self.path, self.most)


class ScenePart(Protocol):
    """Vertices of a scene that the same skeletons move, and the triangles over them.

    Attributes
    ----------
    skeletons : tuple of hashable
        Keys of the skeletons, whose bones `indices` counts one skeleton after the other.
    indices : (V, K) int array
    weights : (V, K) float array
    faces : (T, 3) int array
        Over the part's own vertices.
    uv : (T, 3, 2) float32 array or None
    normals : (T, 3, 3) float32 array or None
    """

    skeletons: tuple[Hashable, ...]
    indices: NDArray[np.int32]
    weights: NDArray[np.floating]
    faces: NDArray[np.int64]
    uv: NDArray[np.float32] | None
    normals: NDArray[np.float32] | None


@dataclasses.dataclass(frozen=True, eq=False)
class Bones:
    """The bones of a skeleton: names, parents (B,), joints (B, 3), transforms (F, B, 3, 4)."""

    names: Sequence[str]
    parents: NDArray[np.integer]
    joint_positions: NDArray[np.float64]
    transforms: NDArray[np.float64]


def part_starts(parts: Sequence[ScenePart]) -> NDArray[np.int64]:
    """First vertex of each part where they follow each other, and the number of all vertices."""
    return np.cumsum([0, *(len(part.indices) for part in parts)])


def join_faces(parts: Sequence[ScenePart]) -> NDArray[np.int32]:
    """Triangles of all parts, whose vertices follow each other."""
    starts = part_starts(parts)[:-1]
    joined = [part.faces + start for part, start in zip(parts, starts, strict=True)]
    return np.concatenate(joined).astype(np.int32)


def join_surface(
    parts: Sequence[ScenePart],
    rest: Sequence[NDArray[np.floating]],
    material_index: Sequence[NDArray[np.integer]],
    materials: Sequence[Material],
) -> Surface | None:
    """UVs, normals and materials of all parts; None where there are none.

    A part without UVs beside others that have some gets zeros, one without normals those of its
    rest pose. `material_index` holds an array (T,) for each part, -1 where a triangle has none; it
    gets a default material.
    """
    if not sum(len(part.faces) for part in parts):
        return None
    uv = normals = None
    if any(part.uv is not None for part in parts):
        blank = [np.zeros((len(part.faces), 3, 2), dtype=np.float32) for part in parts]
        uv = [b if p.uv is None else p.uv for p, b in zip(parts, blank, strict=True)]
    if any(part.normals is not None for part in parts):
        normals = [
            corner_normals(points, part.faces, None) if part.normals is None else part.normals
            for part, points in zip(parts, rest, strict=True)
        ]
    if uv is None and normals is None and not materials:
        return None
    index = np.concatenate(material_index)
    if materials and (index < 0).any():
        index = np.where(index < 0, len(materials), index)
        materials = [*materials, Material(name="default")]
    return Surface(
        uv=None if uv is None else np.concatenate(uv),
        normals=None if normals is None else np.concatenate(normals),
        material_index=index.astype(np.int32) if materials else None,
        materials=tuple(materials),
    )


def join_skinning(
    parts: Sequence[ScenePart],
    rest: Sequence[NDArray[np.floating]],
    bones: Mapping[Hashable, Bones],
    *,
    clips: Sequence[Clip],
    name: str,
    surface: Surface | None,
) -> Skinning:
    """One skinning of all parts; parts of one skeleton share its bones.

    Parameters
    ----------
    parts : sequence of ScenePart
    rest : sequence of (V, 3) arrays
        Rest pose of each part.
    bones : mapping
        Bones of each skeleton, the frames of all clips one after the other.
    clips : sequence of Clip
    name : str
    surface : Surface or None
    """
    keys = list(dict.fromkeys(key for part in parts for key in part.skeletons))
    counts = [len(bones[key].names) for key in keys]
    first = dict(zip(keys, np.cumsum([0, *counts]).tolist(), strict=False))
    width = max(part.indices.shape[1] for part in parts)
    indices, weights = [], []
    for part in parts:
        numbers = [first[key] + np.arange(len(bones[key].names)) for key in part.skeletons]
        pad = ((0, 0), (0, width - part.indices.shape[1]))
        indices.append(np.pad(np.concatenate(numbers)[part.indices], pad))
        weights.append(np.pad(part.weights, pad))
    found = [bones[key] for key in keys]
    transforms = np.concatenate([one.transforms for one in found], axis=1)
    parents = np.concatenate(
        [
            np.where(bones[k].parents >= 0, bones[k].parents + start, -1)
            for k, start in first.items()
        ]
    )
    tree = bool((parents >= 0).any())
    joined = np.concatenate(weights)
    return Skinning(
        np.concatenate(rest),
        np.where(joined > 0, np.concatenate(indices), 0),
        joined,
        transforms,
        faces=join_faces(parts),
        bone_model=bone_model_of(transforms),
        surface=surface,
        bone_names=unique_names([name for one in found for name in one.names]),
        name=name,
        clips=in_order(clips),
        parents=parents if tree else None,
        joint_positions=np.concatenate([one.joint_positions for one in found]) if tree else None,
    )


def bone_model_of(transforms: NDArray[np.float64]) -> BoneModel:
    """The narrowest bone model that holds the transforms to float32 accuracy."""
    linear = transforms[..., :3]
    gram = np.swapaxes(linear, -1, -2) @ linear
    size = np.trace(gram, axis1=-2, axis2=-1) / 3
    off = np.abs(gram - size[..., None, None] * np.eye(3)).max(axis=(-1, -2))
    if (off > 1e-4 * size).any() or (np.linalg.det(linear) <= 0).any():
        return "affine"
    return "rigid" if np.abs(size - 1).max() < 1e-4 else "similarity"


def bake(
    parts: Sequence[ScenePart],
    n_frames: int,
    posed: Iterable[tuple[Shape, NDArray[np.float64]]],
) -> NDArray[np.float32]:
    """Skinned vertices ``(F, V, 3)`` of all parts.

    Parameters
    ----------
    parts : sequence of ScenePart
    n_frames : int
    posed : iterable of (shape, transforms)
        For each part its vertices (V, 3) before skinning, or a function that gives those of a
        frame, and its transforms (F, B, 3, 4).
    """
    starts = part_starts(parts)
    frames = np.empty((n_frames, starts[-1], 3), dtype=np.float32)
    for part, start, (shape, transforms) in zip(parts, starts[:-1], posed, strict=True):
        out = frames[:, start : start + len(part.indices)]
        step = 1 if callable(shape) else max(1, _CHUNK_BYTES // (24 * out.shape[1]))
        for first in range(0, n_frames, step):
            block = slice(first, first + step)
            rest = shape(first) if callable(shape) else shape
            out[block] = skin(rest, part.indices, part.weights, transforms[block], dtype=np.float64)
    return frames


def match_template(
    parts: Sequence[ScenePart], model: Skinning, path: Path
) -> list[NDArray[np.integer]]:
    """The model's vertex for each vertex of each part of a template.

    Raises
    ------
    InputError
        If the model has another number of vertices, or other triangles.
    """
    starts = part_starts(parts)
    count = int(starts[-1])
    vertex: NDArray[np.integer] = np.arange(count)
    if model.vertex_map is not None and len(model.vertex_map) == count:
        vertex = model.vertex_map
    elif model.n_vertices != count:
        raise InputError("template", f"a file of {model.n_vertices} vertices", f"{count} in {path}")
    if not np.array_equal(vertex[join_faces(parts)], model.faces):
        raise InputError("template", "a file with the model's triangles", str(path))
    return np.split(vertex, starts[1:-1])


def check_kept(lost: Sequence[str], strict: bool) -> None:
    """Refuse to lose something of a template where `strict`.

    Raises
    ------
    InputError
        If something is lost.
    """
    if lost and strict:
        raise InputError("template", "a file all of which can be kept", "; ".join(lost))
