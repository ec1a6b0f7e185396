"""glTF's meshes: vertices that move together, their skins, morph targets and looks."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...sequence import Material, Surface
from ..registry import reading
from .animation import World
from .compression import DRACO, decode_primitive
from .document import Document

__all__ = ["Part", "check_meshes", "join_surface", "read_parts"]

_log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Part:
    """Vertices of one node's mesh that share their attributes, and the triangles over them."""

    node: int
    mesh: int
    skin: int | None
    positions: NDArray[np.float64]
    targets: NDArray[np.float64]
    indices: NDArray[np.int32]
    weights: NDArray[np.float64]
    vertex: NDArray[np.int64]  # the file's vertex that stands for each of ours
    label: NDArray[np.int64]  # which of ours each of the file's vertices is
    primitives: tuple[int, ...]  # in the mesh
    faces: NDArray[np.int64]
    uv: NDArray[np.float32] | None
    normals: NDArray[np.float32] | None
    material: NDArray[np.int64]  # -1: the default one

    def morph_weights(self, world: World) -> NDArray[np.float64] | None:
        """Amounts ``(F, targets)`` of the morph targets, None where there are none."""
        if not len(self.targets):
            return None
        document, count = world.document, len(self.targets)
        values = world.clip.sample(self.node, "weights")
        if values is None:
            zeros = [0.0] * count
            holder = world.nodes[self.node]
            if "weights" not in holder:
                holder = document.item("meshes", self.mesh)
            values = document.numbers(holder, "weights", zeros)[None]
        if values.shape[1] != count:
            raise document.error(f"{values.shape[1]} morph weights for {count} targets")
        return np.broadcast_to(values, (world.clip.n_frames, count))

    def morphs(self, world: World) -> bool:
        """True where targets do more than change the rest pose once and for all."""
        amounts = self.morph_weights(world)
        return amounts is not None and bool((amounts != amounts[:1]).any())

    def rest(self, world: World) -> NDArray[np.float64]:
        amounts = self.morph_weights(world)
        if amounts is None:
            return self.positions
        return np.asarray(self.positions + np.einsum("k,kvc->vc", amounts[0], self.targets))

    def matrices(self, world: World) -> NDArray[np.float64]:
        """Transforms ``(F, B, 3, 4)`` from the rest pose."""
        document, count = world.document, world.clip.n_frames
        if self.skin is None:
            found = world.matrices(self.node)[:, None, :3]
            return np.broadcast_to(found, (count, 1, 3, 4))
        joints, inverse = _skin(document, self.skin)
        result = np.empty((count, len(joints), 3, 4))
        for k, joint in enumerate(joints):
            result[:, k] = (world.matrices(joint) @ inverse[k])[:, :3]
        return result

    @staticmethod
    def triangles(document: Document, primitive: dict[str, Any]) -> NDArray[np.int64]:
        """Triangles (T, 3) of a primitive, over the file's vertices."""
        position = document.item("accessors", primitive["attributes"]["POSITION"])
        return _triangles(document, primitive, int(position["count"]))

    def hierarchy(self, world: World) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Parents (B,) and joints (B, 3) in the rest pose: a mesh without a skin hangs on none."""
        if self.skin is None:
            return np.full(1, -1, dtype=np.int32), np.zeros((1, 3))
        joints, inverse = _skin(world.document, self.skin)
        number = {joint: k for k, joint in enumerate(joints)}
        parents = [next((number[a] for a in world.above(j) if a in number), -1) for j in joints]
        # a joint of size 0 in the rest pose is nowhere
        usable = np.abs(np.linalg.det(inverse[:, :3, :3])) > 1e-30
        bind = np.linalg.inv(np.where(usable[:, None, None], inverse, np.eye(4)))
        return np.array(parents, dtype=np.int32), bind[:, :3, 3]

    def has_axes(self, document: Document) -> bool:
        """True where joints of the rest pose are turned against the axes of the world."""
        if self.skin is None:
            return False
        linear = _skin(document, self.skin)[1][:, :3, :3]
        return bool(np.abs(linear - np.eye(3)).max() > 1e-6)

    def bone_names(self, document: Document) -> list[str]:
        nodes = [self.node] if self.skin is None else _skin(document, self.skin)[0]
        return [str(document.item("nodes", k).get("name", f"node_{k}")) for k in nodes]


def read_parts(document: Document, world: World, meshes: Sequence[str] | None = None) -> list[Part]:
    """All triangles and points of the scene, or of the named meshes alone.

    Raises
    ------
    FormatError
        If there are none, or an index, an accessor or a joint is not there.
    """
    parts: list[Part] = []
    for node in world.visible:
        item = world.nodes[node]
        if "mesh" not in item:
            continue
        mesh = document.integer(item["mesh"], "a mesh", len(document.items("meshes")))
        if meshes is not None and not _called(document, node) & set(meshes):
            continue
        skin = None
        if "skin" in item:
            skin = document.integer(item["skin"], "a skin", len(document.items("skins")))
        groups: dict[str, dict[int, dict[str, Any]]] = {}
        for place, primitive in enumerate(
            document.array(document.item("meshes", mesh), "primitives")
        ):
            if DRACO in document.dictionary(primitive, "extensions"):
                decode_primitive(document, primitive)
            if primitive.get("mode", 4) in (1, 2, 3):
                _log.warning("%s: lines in mesh %d are left out", document.path, mesh)
                continue
            # Primitives over the same vertices, one a material, are one mesh.
            key = repr((_attributes(document, primitive), document.array(primitive, "targets")))
            groups.setdefault(key, {})[place] = primitive
        parts += [_part(document, world, node, mesh, skin, group) for group in groups.values()]
    if not parts:
        raise document.error("the scene holds no mesh")
    return parts


def _called(document: Document, node: int) -> set[str]:
    """What the mesh of a node is called: the mesh's name and the node's."""
    item = document.item("nodes", node)
    return {str(x["name"]) for x in (document.item("meshes", item["mesh"]), item) if x.get("name")}


def check_meshes(document: Document, meshes: Any, argument: str = "meshes") -> list[str] | None:
    """Names of meshes as a list.

    Raises
    ------
    InputError
        If no mesh of the file is called so.
    """
    if meshes is None:
        return None
    wanted = [meshes] if isinstance(meshes, str) else list(meshes)
    with reading(document.path):
        nodes = [k for k, n in enumerate(document.items("nodes")) if "mesh" in n]
        known = set().union(*(_called(document, k) for k in nodes))
    for name in wanted:
        if name not in known:
            raise InputError(argument, f"one of {sorted(known)}", repr(name))
    return wanted


def _attributes(document: Document, primitive: dict[str, Any]) -> list[tuple[str, Any]]:
    attributes = document.dictionary(primitive, "attributes")
    if "POSITION" not in attributes:
        raise document.error("a primitive has no POSITION")
    return sorted(attributes.items())


def _part(
    document: Document,
    world: World,
    node: int,
    mesh: int,
    skin: int | None,
    primitives: dict[int, dict[str, Any]],
) -> Part:
    group = list(primitives.values())
    attributes = group[0]["attributes"]
    positions = document.accessor(attributes["POSITION"], ("VEC3",), "POSITION")
    count = len(positions)

    def attribute(name: str, kinds: tuple[str, ...], **options: Any) -> NDArray[Any] | None:
        if name not in attributes:
            return None
        values = document.accessor(attributes[name], kinds, name, **options)
        if len(values) != count:
            raise document.error(f"{len(values)} {name} for {count} vertices")
        return values

    targets = []
    for target in document.array(group[0], "targets"):
        moved = np.zeros((count, 3))
        if "POSITION" in target:
            moved = document.accessor(target["POSITION"], ("VEC3",), "a morph target")
        if len(moved) != count:
            raise document.error(f"a morph target of {len(moved)} for {count} vertices")
        targets.append(moved)
    indices, weights = _influences(document, skin, attributes, attribute, count)
    blocks = [_triangles(document, primitive, count) for primitive in group]
    faces = np.concatenate(blocks)
    materials = len(document.items("materials"))
    material = np.concatenate(
        [
            np.full(
                len(block),
                document.integer(primitive["material"], "a material", materials)
                if "material" in primitive
                else -1,
            )
            for block, primitive in zip(blocks, group, strict=True)
        ]
    )
    uv = attribute(_uv_name(document, group), ("VEC2",))
    normals = attribute("NORMAL", ("VEC3",))
    if skin is None:
        linear = world.matrices(node)[0, :3, :3]
        if np.linalg.det(linear) < 0:
            faces = faces[:, ::-1]  # a mirrored node turns triangles inside out
        if normals is not None:
            normals = normals @ np.linalg.pinv(linear)
    if normals is not None:
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.where(length > 0, normals / np.where(length > 0, length, 1), [0.0, 1.0, 0.0])
    if uv is not None:
        uv = np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1)
    vertex, label = _closed_seams(
        document, attribute("_VERTEX", ("SCALAR",)), positions, targets, indices, weights
    )
    return Part(
        node=node,
        mesh=mesh,
        skin=skin,
        positions=positions[vertex],
        targets=np.array(targets)[:, vertex] if targets else np.zeros((0, len(vertex), 3)),
        indices=indices[vertex],
        weights=weights[vertex],
        vertex=vertex,
        label=label,
        primitives=tuple(primitives),
        faces=label[faces],
        uv=None if uv is None else uv[faces].astype(np.float32),
        normals=None if normals is None else normals[faces].astype(np.float32),
        material=material,
    )


def _triangles(document: Document, primitive: dict[str, Any], count: int) -> NDArray[np.int64]:
    if "indices" in primitive:
        found = document.accessor(primitive["indices"], ("SCALAR",), "indices", integers=True)
        index = found.astype(np.int64)
        if int(index.max()) >= count:
            raise document.error(f"index {index.max()} into {count} vertices")
    else:
        index = np.arange(count)
    mode = primitive.get("mode", 4)
    if mode == 0:
        return np.zeros((0, 3), dtype=np.int64)
    if mode == 4:
        if len(index) % 3:
            raise document.error(f"{len(index)} indices are no triangles")
        return index.reshape(-1, 3)
    if len(index) < 3:
        raise document.error(f"a strip or fan of {len(index)} vertices")
    if mode == 5:
        strip = np.stack([index[:-2], index[1:-1], index[2:]], axis=1)
        strip[1::2] = strip[1::2][:, [1, 0, 2]]
        return strip
    if mode == 6:
        return np.stack([np.full(len(index) - 2, index[0]), index[1:-1], index[2:]], axis=1)
    raise document.error(f"primitive mode {mode!r}")


def _skin(document: Document, index: int) -> tuple[list[int], NDArray[np.float64]]:
    item = document.item("skins", index)
    nodes = len(document.items("nodes"))
    joints = [document.integer(j, "a joint", nodes) for j in document.array(item, "joints")]
    if not joints:
        raise document.error(f"skin {index} has no joints")
    if "inverseBindMatrices" not in item:
        return joints, np.tile(np.eye(4), (len(joints), 1, 1))
    flat = document.accessor(item["inverseBindMatrices"], ("MAT4",), "inverseBindMatrices")
    if len(flat) < len(joints):
        raise document.error(f"{len(flat)} inverse bind matrices for {len(joints)} joints")
    return joints, np.swapaxes(flat[: len(joints)].reshape(-1, 4, 4), 1, 2)


def _influences(
    document: Document, skin: int | None, attributes: dict[str, Any], attribute: Any, count: int
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    if skin is None:
        return np.zeros((count, 1), dtype=np.int32), np.ones((count, 1))
    n_joints = len(_skin(document, skin)[0])
    blocks = []
    for k in range(64):
        if f"JOINTS_{k}" not in attributes:
            break
        indices = attribute(f"JOINTS_{k}", ("VEC4",), integers=True)
        weights = attribute(f"WEIGHTS_{k}", ("VEC4",))
        if weights is None:
            raise document.error(f"JOINTS_{k} without WEIGHTS_{k}")
        blocks.append((indices.astype(np.int64), weights))
    if not blocks:
        raise document.error("a skinned mesh has no JOINTS_0")
    joint = np.concatenate([j for j, _ in blocks], axis=1)
    weight = np.concatenate([w for _, w in blocks], axis=1)
    if (weight < 0).any():
        raise document.error("negative skin weights")
    bad = (joint >= n_joints) & (weight > 0)
    if bad.any():
        raise document.error(f"joint {joint[bad].max()} of a skin of {n_joints}")
    total = weight.sum(axis=1, keepdims=True)
    if (total <= 0).any():
        raise document.error(f"{int((total <= 0).sum())} vertices have no skin weight")
    if np.abs(total - 1).max() > 1e-3:
        _log.warning("%s: skin weights that do not sum to 1 are scaled", document.path)
    used = weight.max(axis=0) > 0
    width = int(np.flatnonzero(used).max()) + 1
    kept = np.where(weight > 0, joint, 0).astype(np.int32)
    return kept[:, :width], (weight / total)[:, :width]


def _closed_seams(
    document: Document,
    mark: NDArray[Any] | None,
    positions: NDArray[np.float64],
    targets: list[NDArray[np.float64]],
    indices: NDArray[np.int32],
    weights: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Undo the writer's splitting of vertices: representative of each vertex, and its label."""
    same = np.arange(len(positions))
    if mark is None:
        return same, same
    label = np.rint(mark).astype(np.int64)
    found, vertex = np.unique(label, return_index=True)
    if (label != mark).any() or found[0] != 0 or found[-1] != len(found) - 1:
        return same, same  # the mark of somebody else
    first = vertex[label]
    compared: list[NDArray[Any]] = [positions, *targets, indices, weights]
    for values in compared:
        if (values[first] != values).any():
            _log.warning("%s: edited since it was written, seams stay open", document.path)
            return same, same
    return vertex, label


def _uv_name(document: Document, group: list[dict[str, Any]]) -> str:
    for primitive in group:
        if "material" in primitive:
            item = document.item("materials", primitive["material"])
            look = document.dictionary(item, "pbrMetallicRoughness")
            texture = document.dictionary(look, "baseColorTexture")
            if "texCoord" in texture:
                return f"TEXCOORD_{document.integer(texture['texCoord'], 'texCoord', 64)}"
    return "TEXCOORD_0"


def join_surface(document: Document, parts: list[Part], n_faces: int) -> Surface | None:
    """Corners of all parts; zeros (UV) or flat normals where a part of several has none."""
    joined: dict[str, NDArray[np.float32] | None] = {}
    for name, width in (("uv", 2), ("normals", 3)):
        found = [getattr(part, name) for part in parts]
        if all(values is None for values in found):
            joined[name] = None
            continue
        blocks = []
        for part, values in zip(parts, found, strict=True):
            if values is None and name == "normals":
                p = part.positions[part.faces]
                flat = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
                length = np.linalg.norm(flat, axis=1, keepdims=True)
                flat = np.where(length > 0, flat / np.where(length > 0, length, 1), [0.0, 1.0, 0.0])
                values = np.repeat(flat[:, None], 3, axis=1).astype(np.float32)
            blocks.append(
                np.zeros((len(part.faces), 3, width), np.float32) if values is None else values
            )
        joined[name] = np.concatenate(blocks)
    index = np.concatenate([part.material for part in parts])
    items = document.items("materials")
    materials = [_material(document, document.item("materials", k)) for k in range(len(items))]
    if materials and (index < 0).any():
        index = np.where(index < 0, len(materials), index)
        materials.append(Material(name="default", base_color=(1.0, 1.0, 1.0, 1.0)))
    if not n_faces or (not materials and all(values is None for values in joined.values())):
        return None
    return Surface(
        uv=joined["uv"],
        normals=joined["normals"],
        material_index=index.astype(np.int32) if materials else None,
        materials=tuple(materials),
    )


def _material(document: Document, item: dict[str, Any]) -> Material:
    look = document.dictionary(item, "pbrMetallicRoughness")
    color = document.numbers(look, "baseColorFactor", [1.0] * 4)
    texture, kind = None, "image/png"
    reference = document.dictionary(look, "baseColorTexture")
    if reference:
        texture, kind = _texture(document, reference)
    return Material(
        name=str(item.get("name", "material")),
        base_color=(float(color[0]), float(color[1]), float(color[2]), float(color[3])),
        metallic=document.number(look.get("metallicFactor", 1.0), "metallicFactor"),
        roughness=document.number(look.get("roughnessFactor", 1.0), "roughnessFactor"),
        double_sided=bool(item.get("doubleSided", False)),
        texture=texture,
        texture_type=kind,
    )


def _texture(document: Document, reference: dict[str, Any]) -> tuple[bytes | None, str]:
    if "KHR_texture_transform" in document.dictionary(reference, "extensions"):
        _log.warning("%s: the transform of a texture is left out", document.path)
    texture = document.item("textures", reference.get("index"))
    if "source" not in texture:
        _log.warning("%s: a texture has no PNG or JPEG image", document.path)
        return None, "image/png"
    image = document.item("images", texture["source"])
    if "bufferView" in image:
        data = bytes(document.view(image["bufferView"])[0])
    else:
        data = document.uri(image.get("uri"), "an image")
    kind = "image/jpeg" if data.startswith(b"\xff\xd8\xff") else "image/png"
    return data, str(image.get("mimeType", kind))
