"""Joining of a scene's meshes into one skinning, and of their triangles and surfaces into one."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..common.checks import BoneModel
from ..mesh.clips import in_order, unique_names
from ..mesh.normals import corner_normals
from ..mesh.surface import Material, Space, Surface
from ..model.shapes import ShapedSkinning, Shapes, Skinned
from ..model.skinning import Skinning
from .file_errors import afford, check
from .sampling import Sample, part_starts

_log = logging.getLogger(__name__)

Shape = NDArray[np.float64] | Callable[[int], NDArray[np.float64]]


class ScenePart(Protocol):
    """Vertices of a scene that one skeleton moves, and their triangles.

    `shape(time)` returns the vertices (V, 3) before skinning or, if these change over time, a
    function from a frame's index to vertices. `at_rest(time)` returns the vertices without shapes,
    and the shapes. `transforms(time)` returns the transforms (F, B, 3, 4) of the bones from the
    rest pose. `bones(transforms)` returns the skeleton with such transforms. `shown(time)` returns
    the mask (F,) of the frames in which the file shows the part. `time` is that of a
    :class:`Sample`.

    Attributes
    ----------
    name : str
    skeleton : hashable
        Identity of the skeleton: parts whose identities are equal share its bones.
    indices : (V, K) int array
        Bones of the skeleton that move each vertex.
    weights : (V, K) float array
    faces : (T, 3) int array
        Indices into the part's own vertices.
    uv, normals, colors : (T, 3, 2), (T, 3, 3) and (T, 3, 4) float32 arrays or None
        As in :class:`~ssdr.Surface`, at the corners of the triangles.
    material : (T,) int array
        Index of each triangle's material among those of the scene; -1 stands for a default one.
    """

    name: str
    skeleton: Any
    indices: NDArray[np.int32]
    weights: NDArray[np.float64]
    faces: NDArray[np.int64]
    material: NDArray[np.integer]

    @property
    def uv(self) -> NDArray[np.float32] | None: ...
    @property
    def normals(self) -> NDArray[np.float32] | None: ...
    @property
    def colors(self) -> NDArray[np.float32] | None: ...
    def shape(self, time: Any, /) -> Shape: ...
    def at_rest(self, time: Any, /) -> tuple[NDArray[np.float64], Shapes | None]: ...
    def transforms(self, time: Any, /) -> NDArray[np.float64]: ...
    def bones(self, transforms: NDArray[np.float64], /) -> Bones: ...
    def shown(self, time: Any, /) -> NDArray[np.bool_]: ...


@dataclasses.dataclass(frozen=True, eq=False)
class Bones:
    """Skeleton of B bones: names, parents (B,), joints (B, 3) and transforms (F, B, 3, 4)."""

    names: Sequence[str]
    parents: NDArray[np.integer]
    joint_positions: NDArray[np.float64]
    transforms: NDArray[np.float64]


def file_weights(
    indices: NDArray[np.integer], weights: NDArray[np.floating], n_joints: int, what: object
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Check indices and weights (V, K) of a file, and return them for a model.

    Weights are scaled to sum 1, and the indices of unused influences become 0. `what` names the
    mesh in messages.

    Raises
    ------
    FormatError
        If a weight is negative or not finite, a vertex has no weight above 0, or an index is not
        below `n_joints`.
    """
    usable = np.isfinite(weights).all() and (weights >= 0).all()
    check(usable, f"{what}: skin weights that are negative or not finite")
    used = np.where(weights > 0, indices, 0).astype(np.int32)
    for index in (used.min(initial=0), used.max(initial=0)):
        check(0 <= index < n_joints, f"{what}: joint {index} of a skin of {n_joints}")
    total = weights.sum(axis=1, keepdims=True)
    bare = np.count_nonzero(total <= 0)
    check(not bare, f"{what}: {bare} vertices have no skin weight")
    if np.abs(total - 1).max() > 1e-3:
        _log.warning("%s: skin weights that do not sum to 1 are scaled", what)
    return used, weights / total


def nearest_joints(
    joints: Sequence[Hashable], ancestors: Callable[[Any], Iterable[Hashable]]
) -> NDArray[np.int64]:
    """Index (B,) of the nearest ancestor of each joint that is a joint, too, or -1.

    `ancestors` returns what is above a joint, the nearest first.
    """
    number = {joint: k for k, joint in enumerate(joints)}
    found = (next((number[a] for a in ancestors(j) if a in number), -1) for j in joints)
    return np.fromiter(found, dtype=np.int64, count=len(joints))


def vertices_at_joints(
    count: int,
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.int64]]:
    """Indices, weights and faces of a model without a mesh, which has a vertex at each joint."""
    return (
        np.arange(count, dtype=np.int32)[:, None],
        np.ones((count, 1)),
        np.zeros((0, 3), dtype=np.int64),
    )


def facing(linear: NDArray[np.floating]) -> tuple[int, bool]:
    """First frame in which matrices (F, 3, 3) have the usual sign of det, and whether it is -1.

    The usual sign is that of most frames. The sign of a mesh which grows from size 0 is 0 at first.
    """
    largest = np.abs(linear).max(axis=(1, 2), keepdims=True)
    signs = np.sign(np.linalg.det(linear / np.where(largest > 0, largest, 1)))
    mirrored = bool(signs.sum() < 0)
    return int(np.argmax(signs == (-1 if mirrored else 1))), mirrored


def join_faces(parts: Sequence[ScenePart]) -> NDArray[np.int32]:
    """Triangles (T, 3) of all parts, as indices into their concatenated vertices."""
    starts = part_starts(parts)[:-1]
    joined = [part.faces + start for part, start in zip(parts, starts, strict=True)]
    return np.concatenate(joined).astype(np.int32)


def join_surface(
    parts: Sequence[ScenePart], rest: Sequence[NDArray[np.floating]], materials: list[Material]
) -> Surface | None:
    """Surface of all parts joined, or None if there is nothing to state.

    If only some parts have UVs, the others get zeros; if only some have normals, the others get
    those of their rest pose; if only some have colours, the others become white.
    """
    index = np.concatenate([part.material for part in parts])
    if not len(index):
        return None
    fields: dict[str, Any] = {}
    for field, usual in (("uv", [0, 0]), ("normals", None), ("colors", [1, 1, 1, 1])):
        held = [getattr(part, field) for part in parts]
        if all(one is None for one in held):
            continue
        for k, part in enumerate(parts):
            if held[k] is None:
                plain = None if usual is None else np.tile(usual, (len(part.faces), 3, 1))
                held[k] = corner_normals(rest[k], part.faces, None) if plain is None else plain
        fields[field] = np.concatenate(held).astype(np.float32, copy=False)
    if not (fields or materials):
        return None
    if materials and (index < 0).any():
        index = np.where(index < 0, len(materials), index)
        materials = [*materials, Material(name="default")]
    numbers = index.astype(np.int32) if materials else None
    return Surface(material_index=numbers, materials=tuple(materials), **fields)


def join_skinning(
    samples: Sequence[Sample], materials: list[Material], name: str, space: Space
) -> Skinned:
    """Skinning called `name` of all parts, with one clip for each sample.

    It has the narrowest bone model that holds the transforms, and a hierarchy if some bone has a
    parent.

    Raises
    ------
    FormatError
        If anything but shapes changes the vertices of a part before they are skinned.
    """
    parts = samples[0].parts
    bones: dict[Hashable, Bones] = {}
    for k, part in enumerate(parts):
        if part.skeleton not in bones:
            moved = [one.parts[k].transforms(one.time) for one in samples]
            bones[part.skeleton] = part.bones(np.concatenate(moved))
    held = [[part.at_rest(one.time) for part in one.parts] for one in samples]
    rest = [points for points, _ in held[0]]
    found = list(bones.values())
    starts = np.cumsum([0, *(len(one.names) for one in found)])[:-1]
    first = dict(zip(bones, starts, strict=True))
    width = max(part.indices.shape[1] for part in parts)

    def widened(part: ScenePart, values: NDArray[Any]) -> NDArray[Any]:
        return np.pad(values, ((0, 0), (0, width - part.indices.shape[1])))

    parents = np.concatenate(
        [
            np.where(one.parents >= 0, one.parents + start, -1)
            for one, start in zip(found, starts, strict=True)
        ]
    )
    indices = [widened(part, part.indices + first[part.skeleton]) for part in parts]
    weights = np.concatenate([widened(part, part.weights) for part in parts])
    transforms = np.concatenate([one.transforms for one in found], axis=1)
    joints = np.concatenate([one.joint_positions for one in found])
    tree = bool((parents >= 0).any())
    model = Skinning(
        np.concatenate(rest),
        np.where(weights > 0, np.concatenate(indices), 0),
        weights,
        transforms,
        faces=join_faces(parts),
        bone_model=_bone_model_of(transforms),
        bone_names=unique_names([name for one in found for name in one.names]),
        parents=parents if tree else None,
        joint_positions=joints if tree else None,
        surface=join_surface(parts, rest, materials),
        name=name,
        clips=in_order(one.clip for one in samples),
        space=space,
    )
    shapes = _join_shapes([[shapes for _, shapes in one] for one in held], part_starts(parts), name)
    return model if shapes is None else ShapedSkinning(model, shapes)


def _join_shapes(
    held: Sequence[Sequence[Shapes | None]], starts: NDArray[np.int64], name: str
) -> Shapes | None:
    """Shapes of the joined vertices, from the shapes `held` by each part in each clip, or None.

    Shapes of several parts that have the same name and amounts become one.  `starts` holds the
    first vertex of each part, then the number of vertices; `name` is that of the file, for
    messages.
    """
    rows: dict[tuple[str, bytes], dict[int, NDArray[np.floating]]] = {}
    amounts: dict[tuple[str, bytes], NDArray[np.float64]] = {}
    for k, of_clips in enumerate(zip(*held, strict=True)):
        some = [shapes for shapes in of_clips if shapes is not None]
        for s in range(len(some[0]) if some else 0):
            column = np.concatenate([shapes.amounts[:, s] for shapes in some])
            key = some[0].names[s], column.tobytes()
            rows.setdefault(key, {})[k] = some[0].displacements[s]
            amounts[key] = column
    if not rows:
        return None
    afford(24.0 * len(rows) * starts[-1], f"{len(rows)} shapes of {starts[-1]} vertices", name)
    moved = np.zeros((len(rows), starts[-1], 3))
    for one, of_parts in zip(moved, rows.values(), strict=True):
        for k, displacements in of_parts.items():
            one[starts[k] : starts[k + 1]] = displacements
    columns = np.stack(list(amounts.values()), axis=1)
    return Shapes(moved, columns, names=[known for known, _ in rows])


def _bone_model_of(transforms: NDArray[np.float64]) -> BoneModel:
    """Most restrictive bone model that represents the transforms to about 1e-4."""
    linear = transforms[..., :3]
    gram = np.swapaxes(linear, -1, -2) @ linear
    size = np.trace(gram, axis1=-2, axis2=-1) / 3
    off = np.abs(gram - size[..., None, None] * np.eye(3)).max(axis=(-1, -2))
    if (off > 1e-4 * size).any() or (np.linalg.det(linear) <= 0).any():
        return "affine"
    return "rigid" if np.abs(size - 1).max() < 1e-4 else "similarity"
