"""glTF's meshes: vertices that move together, their skins, morph targets and materials."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import FormatError
from ...mesh.clips import readable
from ...mesh.normals import unit
from ...model.shapes import Shapes
from ..file_errors import check
from ..mesh_names import choose
from ..meshes.polygons import opaque
from ..scene import Bones, Shape, facing, file_weights, nearest_joints, vertices_at_joints
from .animation import Nodes, descendants, every_track, still_frame
from .compression import DRACO, decode_mesh
from .document import Document

_log = logging.getLogger(__name__)


class PrimitiveGroup:
    """The primitives of a node's mesh that share the same vertices, as a `ScenePart`.

    Parameters
    ----------
    document : Document
    nodes : Nodes
    node, mesh : int
        Indices of the node and its mesh in the file.
    primitives : dict
        JSON of the primitives, by index in the mesh.

    Attributes
    ----------
    positions : (V, 3) float64
    targets : (M, V, 3) float64
        Displacements of the morph targets.
    label : (N,) int
        For each vertex of the file, its index in `positions`, where copies at seams are merged.
    skin : int or None
        Index of the node's skin.
    mirrored : bool
        Whether the node mirrors its mesh (without a skin), so that `faces` have been flipped.
    corners : (T, 3) int
        Vertex of the file at each corner.
    material : (T,) int
        Index of each triangle's material; -1 for a triangle without one.
    name, skeleton, indices, weights, faces, uv, normals, colors
        As in `ScenePart`.
    """

    mirrored = False

    def __init__(
        self,
        document: Document,
        nodes: Nodes,
        node: int,
        mesh: int,
        primitives: dict[int, dict[str, Any]],
    ) -> None:
        self.document, self.node, self.mesh, self.primitives = document, node, mesh, primitives
        self._nodes, self.name = nodes, names_of(document, node)[0]
        group = list(primitives.values())
        self._attributes = group[0]["attributes"]
        positions = self._attribute("POSITION", "VEC3")
        count = len(positions)
        targets = [
            document.accessor(t["POSITION"], "VEC3", "a morph target")
            if "POSITION" in t
            else np.zeros_like(positions)
            for t in group[0].get("targets", [])
        ]
        same = all(len(target) == count for target in targets)
        check(same, f"a morph target of other vertices than {count}")
        self.skin = nodes.items[node].get("skin")
        self.skeleton = ("node", node) if self.skin is None else ("skin", self.skin)
        self._joints, self._inverse = self._read_skin()
        indices, weights = self._influences(count)
        blocks = [triangles(document, primitive, count) for primitive in group]
        faces = np.concatenate(blocks)
        material = [primitive.get("material", -1) for primitive in group]
        self.material = np.repeat(material, [len(block) for block in blocks])
        uv = self._attribute(_uv_name(document, group), "VEC2")
        normals = self._attribute("NORMAL", "VEC3")
        if self.skin is None:
            linear = nodes.matrices(node)[:, :3, :3]
            frame, self.mirrored = facing(linear)
            if self.mirrored:
                faces = faces[:, ::-1]  # a mirrored node turns triangles inside out
            if normals is not None:
                normals = normals @ np.linalg.pinv(linear[frame])
        self.uv = self.normals = self.colors = None
        if (color := self._attribute("COLOR_0", "VEC4 VEC3")) is not None:
            self.colors = opaque(color)[faces]
        if uv is not None:
            self.uv = (np.array([0, 1]) + uv * [1, -1])[faces].astype(np.float32)
        if normals is not None:
            self.normals = unit(normals)[faces].astype(np.float32)
        vertex, self.label = self._close_seams([positions, *targets, indices, weights])
        self.positions: NDArray[np.float64] = positions[vertex]
        self.targets = np.array(targets).reshape(-1, count, 3)[:, vertex]
        self.indices, self.weights = indices[vertex], weights[vertex]
        self.corners, self.faces = faces, self.label[faces]

    def _attribute(self, name: str, kind: str, **options: Any) -> Any:
        """Values of the attribute `name` at all vertices, or None if there is no such attribute."""
        if name not in self._attributes:
            return None
        values = self.document.accessor(self._attributes[name], kind, name, **options)
        count = self.document.items("accessors")[self._attributes["POSITION"]]["count"]
        check(len(values) == count, f"{len(values)} {name} for {count} vertices")
        return values

    def _read_skin(self) -> tuple[list[int], NDArray[np.float64]]:
        """Nodes of the skin's joints, and the joints' inverse bind matrices (B, 4, 4).

        Without a skin, the mesh's node is the only joint, with the identity.
        """
        if self.skin is None:
            return [self.node], np.eye(4)[None]
        item = self.document.items("skins")[self.skin]
        joints = list(item["joints"])
        check(joints, f"skin {self.skin} has no joints")
        if "inverseBindMatrices" not in item:
            return joints, np.tile(np.eye(4), (len(joints), 1, 1))
        flat = self.document.accessor(item["inverseBindMatrices"], "MAT4", "inverseBindMatrices")
        problem = f"{len(flat)} inverse bind matrices for {len(joints)} joints"
        check(len(flat) >= len(joints), problem)
        return joints, np.swapaxes(flat[: len(joints)].reshape(-1, 4, 4), 1, 2)

    def _influences(self, count: int) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Bone indices (V, K) and weights (V, K); without a skin, bone 0 with weight 1."""
        document = self.document
        if self.skin is None:
            return np.zeros((count, 1), dtype=np.int32), np.ones((count, 1))
        sets = [k for k in range(64) if f"JOINTS_{k}" in self._attributes]
        check(sets, "a skinned mesh has no JOINTS_0")
        for k in sets:
            check(f"WEIGHTS_{k}" in self._attributes, f"JOINTS_{k} without WEIGHTS_{k}")
        found = [self._attribute(f"JOINTS_{k}", "VEC4", integers=True) for k in sets]
        joint = np.concatenate(found, axis=1).astype(np.int64)  # may be uint32
        weight = np.concatenate([self._attribute(f"WEIGHTS_{k}", "VEC4") for k in sets], axis=1)
        indices, weights = file_weights(joint, weight, len(self._joints), document.path)
        width = int(np.flatnonzero(weights.max(axis=0) > 0).max()) + 1
        return indices[:, :width], weights[:, :width]

    def _close_seams(
        self, compared: list[NDArray[Any]]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Indices that merge the vertices which this package's writer has split at seams.

        The writer's attribute ``_VERTEX`` has the same value at all copies of a vertex. If copies
        differ in one of the arrays `compared`, the file has been edited, and none are merged.

        Returns
        -------
        vertex : (V,) int
            Index in the file of one copy of each merged vertex.
        label : (N,) int
            Index of the merged vertex for each vertex of the file.
        """
        same = np.arange(len(compared[0]))
        mark = self._attribute("_VERTEX", "SCALAR")
        if mark is None:
            return same, same
        label = np.rint(mark).astype(np.int64)
        found, vertex = np.unique(label, return_index=True)
        if (label != mark).any() or found[0] != 0 or found[-1] != len(found) - 1:
            return same, same  # another program's attribute of that name
        if any((values[vertex[label]] != values).any() for values in compared):
            _log.warning("%s: edited since it was written, seams stay open", self.document.path)
            return same, same
        return vertex, label

    def shape(self, nodes: Nodes) -> Shape:
        """Vertices before skinning, or a function from frame to vertices if they change."""
        amounts = self._amounts(nodes)
        if not amounts.size:
            return self.positions

        def morphed(frame: int) -> NDArray[np.float64]:
            return np.asarray(self.positions + np.einsum("k,kvc->vc", amounts[frame], self.targets))

        return morphed if (amounts != amounts[:1]).any() else morphed(0)

    def at_rest(self, nodes: Nodes) -> tuple[NDArray[np.float64], Shapes | None]:
        """Vertices before morphing and skinning, and the morph targets with their amounts."""
        amounts, count = self._amounts(nodes), len(nodes.animation.times)
        if not amounts.size:
            return self.positions, None
        extras = self.document.items("meshes")[self.mesh].get("extras")
        names = extras.get("targetNames") if isinstance(extras, dict) else None
        usable = isinstance(names, list) and len(names) == amounts.shape[1]
        each = np.broadcast_to(amounts, (count, amounts.shape[1]))
        return self.positions, Shapes(self.targets, each, names=names if usable else None)

    def _amounts(self, nodes: Nodes) -> NDArray[np.float64]:
        """Amounts ``(F, M)`` of the morph targets, or ``(1, M)`` if they do not change."""
        count = len(self.targets)
        amounts = nodes.animation.sample(self.node, "weights") if count else None
        if amounts is None:
            holder = nodes.items[self.node] if count else {}
            if count and "weights" not in holder:
                holder = self.document.items("meshes")[self.mesh]
            amounts = self.document.numbers(holder, "weights", [0.0] * count)[None]
        check(amounts.shape[1] == count, f"{amounts.shape[1]} morph weights for {count} targets")
        return amounts

    def shown(self, nodes: Nodes) -> NDArray[np.bool_]:
        """Mask (F,) of the frames in which the mesh is visible."""
        return nodes.visible(self.node)

    def transforms(self, nodes: Nodes) -> NDArray[np.float64]:
        """Transforms ``(F, B, 3, 4)`` of the bones from the rest pose to world space."""
        nodes.reserve(self._joints)
        shape = len(nodes.animation.times), len(self._joints)
        self.document.budget.spend(96 * shape[0] * shape[1], "{} frames of {} bones".format(*shape))
        result = np.empty((*shape, 3, 4))
        for k, joint in enumerate(self._joints):
            result[:, k] = (nodes.matrices(joint) @ self._inverse[k])[:, :3]
        return result

    def bones(self, transforms: NDArray[np.float64]) -> Bones:
        """Bones of the skin with names, parents, rest positions and the given `transforms`."""
        nodes, joints = self._nodes, self._joints
        # a singular inverse bind matrix states no position: the joint is put at the origin
        usable = np.abs(np.linalg.det(self._inverse[:, :3, :3])) > 1e-30
        bind = np.linalg.inv(np.where(usable[:, None, None], self._inverse, np.eye(4)))
        names = [str(nodes.items[k].get("name", f"node_{k}")) for k in joints]
        return Bones(names, nearest_joints(joints, nodes.ancestors), bind[:, :3, 3], transforms)


def names_of(document: Document, number: int) -> list[str]:
    """Names by which the mesh of node `number` can be chosen: those of the node and of the mesh.

    If neither has a name, one is made of the node's index.
    """
    node = document.items("nodes")[number]
    items = node, document.items("meshes")[node["mesh"]]
    found = [readable(item["name"]) for item in items if item.get("name")]
    return found or [f"node_{number}"]


def read_parts(
    document: Document, nodes: Nodes, meshes: str | Sequence[str] | None = None
) -> list[PrimitiveGroup]:
    """Parts of all meshes in the scene, or only of those named in `meshes`; lines are left out.

    Raises
    ------
    FormatError
        If there is no mesh, or an accessor or joint is not usable.
    InputError
        If one of the names is that of no mesh of the scene.
    """
    parts: list[PrimitiveGroup] = []
    names = [names_of(document, number) for number in nodes.meshes]
    numbers = [nodes.meshes[k] for k in choose(meshes, names)]
    skins = {node["skin"] for node in (nodes.items[number] for number in numbers) if "skin" in node}
    nodes.reserve(joint for skin in skins for joint in document.items("skins")[skin]["joints"])
    nodes.reserve(number for number in numbers if "skin" not in nodes.items[number])
    for number in numbers:
        node = nodes.items[number]
        groups: dict[str, dict[int, dict[str, Any]]] = {}
        for place, primitive in enumerate(document.items("meshes")[node["mesh"]]["primitives"]):
            if DRACO in primitive.get("extensions", {}):
                _decode(document, primitive)
            if primitive.get("mode", 4) in (1, 2, 3):
                _log.warning("%s: lines in mesh %d are left out", document.path, node["mesh"])
                continue
            check("POSITION" in primitive["attributes"], "a primitive has no POSITION")
            # Primitives over the same vertices, one for each material, form one part.
            key = repr((sorted(primitive["attributes"].items()), primitive.get("targets", [])))
            groups.setdefault(key, {})[place] = primitive
        for group in groups.values():
            parts.append(PrimitiveGroup(document, nodes, number, node["mesh"], group))
    check(parts, "the scene holds no mesh")
    return parts


class JointPoints(PrimitiveGroup):
    """Point cloud for a file without a mesh, with a vertex at each moving node.

    Moving nodes are those that an animation moves, and all nodes below them. The rest pose is
    that of the file without an animation.

    Raises
    ------
    FormatError
        If no node moves, or one has size 0 at rest.
    """

    def __init__(self, document: Document) -> None:
        still = Nodes(document, still_frame())
        moved = {node for node, path in every_track(document) if path not in ("weights", "visible")}
        below = set(descendants(still.items, sorted(moved))).intersection(still.shown)
        joints = [node for node in still.order if node in below]
        check(joints, "the scene holds no mesh, and no node moves")
        rest = np.stack([still.matrices(joint)[0] for joint in joints])
        check((np.abs(np.linalg.det(rest)) > 1e-30).all(), "a joint has size 0 at rest")
        self.document, self._nodes, self.skeleton = document, still, ("joints", 0)
        self._joints, self._inverse = joints, np.linalg.inv(rest)
        self.positions, self.targets = rest[:, :3, 3], np.zeros((0, len(joints), 3))
        self.indices, self.weights, self.faces = vertices_at_joints(len(joints))
        self.material = np.zeros(0, dtype=np.int64)
        self.uv = self.normals = self.colors = None

    def shown(self, nodes: Nodes) -> NDArray[np.bool_]:
        return np.ones(len(nodes.animation.times), dtype=bool)


def _decode(document: Document, primitive: dict[str, Any]) -> None:
    """Decode a primitive's Draco data into its accessors, unless these have uncompressed data."""
    item, names = primitive["extensions"][DRACO], primitive["attributes"]
    if "bufferView" in document.items("accessors")[names["POSITION"]]:
        return
    found, faces = decode_mesh(bytes(document.view(item["bufferView"])[0]), document.path)
    for name, number in item.get("attributes", {}).items():
        check(name in names and number in found, f"its Draco data hold no {name}")
        document.replace(names[name], found[number], name)
    if "indices" in primitive:
        if faces is None:
            raise FormatError("its Draco data hold no triangles")
        document.replace(primitive["indices"], faces.reshape(-1), "indices")
        check(primitive.get("mode", 4) == 4, "Draco data of a strip or fan")


def triangles(document: Document, primitive: dict[str, Any], count: int) -> NDArray[np.int64]:
    """Triangles (T, 3) of a primitive, which may be a strip or fan; T = 0 if it draws points.

    Corners are indices into the `count` vertices of the primitive.
    """
    index = np.arange(count)
    if "indices" in primitive:
        found = document.accessor(primitive["indices"], "SCALAR", "indices", integers=True)
        index = found.astype(np.int64)
        check(index.max() < count, f"index {index.max()} into {count} vertices")
    mode = primitive.get("mode", 4)
    if mode == 0:
        return np.zeros((0, 3), dtype=np.int64)
    if mode == 4:
        check(len(index) % 3 == 0, f"{len(index)} indices are no triangles")
        return index.reshape(-1, 3)
    check(mode in (5, 6), f"primitive mode {mode!r}")
    check(len(index) >= 3, f"a strip or fan of {len(index)} vertices")
    strip = np.stack([index[:-2], index[1:-1], index[2:]], axis=1)
    if mode == 6:
        strip[:, 0] = index[0]
    else:
        strip[1::2] = strip[1::2][:, [1, 0, 2]]
    return strip


def _uv_name(document: Document, group: list[dict[str, Any]]) -> str:
    """Name of the UV attribute that the texture of `group`'s first material uses."""
    for number in [primitive["material"] for primitive in group if "material" in primitive]:
        look = document.items("materials")[number].get("pbrMetallicRoughness", {})
        if "texCoord" in look.get("baseColorTexture", {}):
            return f"TEXCOORD_{look['baseColorTexture']['texCoord']}"
    return "TEXCOORD_0"
