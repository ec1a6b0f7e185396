"""A skinning put into the glTF file that its mesh came from: all else stays as it is there.

The file is read again when it is written, so that a model carries nothing of it.  Meshes, nodes,
materials, pictures and the bytes of what is not replaced are the file's own; replaced are the
attributes that skinning needs, and the skins, joints and keys that moved these meshes alone.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...skinning import Skinning
from ..carried import carry_normals, carry_tangents
from ..registry import reading
from .animation import Animation, World, every, names_of_clips
from .builder import ARRAY, ELEMENTS, Builder
from .document import Document
from .mesh import Part, check_meshes, read_parts
from .references import remove, unknown_extensions, used

__all__ = ["Template", "open_template"]

_LINES = (1, 2, 3)
_MOTION = ("translation", "rotation", "scale")


@dataclasses.dataclass(eq=False)
class Template:
    """A file into which a model is being put.

    Attributes
    ----------
    builder : Builder
        The file as it will be written.
    parts : list of Part
        What the model replaces, with the first of its vertices.
    spread : (V0,) int array
        The model's vertex of each vertex that was read.
    clip_names : dict
        What the file's clips are called in the model, where that differs.
    lost, notes : list of str
        What cannot be kept, and what else the user should know.
    """

    document: Document
    world: World
    clips: list[Animation]
    parts: list[Part]
    builder: Builder
    spread: NDArray[np.integer]
    clip_names: dict[str, str] = dataclasses.field(default_factory=dict)
    lost: list[str] = dataclasses.field(default_factory=list)
    notes: list[str] = dataclasses.field(default_factory=list)

    @property
    def json(self) -> dict[str, Any]:
        return self.builder.json

    def replaced(self) -> set[int]:
        """Nodes whose meshes are replaced."""
        return {part.node for part in self.parts}

    def own_meshes(self) -> dict[int, int]:
        """A mesh of its own for every node that is replaced; its number by the node's."""
        result: dict[int, int] = {}
        nodes, meshes = self.json["nodes"], self.json["meshes"]
        for node in sorted(self.replaced()):
            mesh = nodes[node]["mesh"]
            if any(n.get("mesh") == mesh for k, n in enumerate(nodes) if k != node):
                meshes.append(copy.deepcopy(meshes[mesh]))
                mesh = nodes[node]["mesh"] = len(meshes) - 1
            result[node] = mesh
        return result

    def put_meshes(self, rest: NDArray[np.float32], influences: Any) -> None:
        """Rest pose and skin weights at the vertices of each part.

        Parameters
        ----------
        rest : (V, 3) array
        influences : callable
            Attributes of skin weights for an index (N,) of the model's vertices.
        """
        meshes = self.own_meshes()
        start = 0
        for part in self.parts:
            index = self.spread[start : start + len(part.vertex)][part.label]
            start += len(part.vertex)
            attributes = self._attributes(part, rest[index], influences(index))
            mirrored = part.skin is None and self._determinant(part.node) < 0
            primitives = self.json["meshes"][meshes[part.node]]["primitives"]
            for place in part.primitives:
                primitive = primitives[place]
                primitive["attributes"] = dict(attributes)
                primitive.pop("targets", None)
                if mirrored and primitive.get("mode", 4) != 0:
                    self._reverse(part, place, primitive)
        for node, number in meshes.items():
            self._clean(node, self.json["meshes"][number])

    def _attributes(
        self, part: Part, rest: NDArray[np.float32], weights: dict[str, int]
    ) -> dict[str, int]:
        document, builder = self.document, self.builder
        primitive = document.item("meshes", part.mesh)["primitives"][part.primitives[0]]
        old = primitive["attributes"]
        kept = {k: v for k, v in old.items() if not k.startswith(("JOINTS_", "WEIGHTS_"))}
        kept["POSITION"] = builder.accessor(rest, "VEC3", target=ARRAY, bounds=True)
        source = document.accessor(old["POSITION"], ("VEC3",), "POSITION")
        corners = [
            part.triangles(document, document.item("meshes", part.mesh)["primitives"][k])
            for k in part.primitives
        ]
        faces = np.concatenate(corners)
        target = rest.astype(np.float64)
        if "NORMAL" in old:
            normals = document.accessor(old["NORMAL"], ("VEC3",), "NORMAL")
            normals = carry_normals(normals, faces, faces, source, target)
            kept["NORMAL"] = builder.accessor(normals, "VEC3", target=ARRAY)
            if "TANGENT" in old:
                tangents = document.accessor(old["TANGENT"], ("VEC4",), "TANGENT")
                if part.skin is None and self._determinant(part.node) < 0:
                    tangents[:, 3] *= -1
                moved = carry_tangents(tangents, normals, faces, faces, source, target)
                kept["TANGENT"] = builder.accessor(moved, "VEC4", target=ARRAY)
        return kept | weights

    def _determinant(self, node: int) -> float:
        return float(np.linalg.det(self.world.matrices(node)[0, :3, :3]))

    def _reverse(self, part: Part, place: int, primitive: dict[str, Any]) -> None:
        """Turn triangles round that a mirrored node turned: joints mirror nothing."""
        old = self.document.item("meshes", part.mesh)["primitives"][place]
        faces = part.triangles(self.document, old)[:, ::-1]
        wide = np.uint16 if faces.max() < 65535 else np.uint32
        flat = faces.reshape(-1).astype(wide)
        primitive["indices"] = self.builder.accessor(flat, "SCALAR", target=ELEMENTS)
        if primitive.get("mode", 4) != 4:
            primitive["mode"] = 4

    def _clean(self, node: int, mesh: dict[str, Any]) -> None:
        """Take out of a mesh what no longer belongs to it: morph targets and lines."""
        name = mesh.get("name") or f"of node {node}"
        lines = [p for p in mesh["primitives"] if p.get("mode", 4) in _LINES]
        if lines:
            self.lost.append(f"lines of the mesh {name}")
            mesh["primitives"] = [p for p in mesh["primitives"] if p.get("mode", 4) not in _LINES]
        mesh.pop("weights", None)
        self.json["nodes"][node].pop("weights", None)
        extras = mesh.get("extras")
        if isinstance(extras, dict) and "targetNames" in extras:
            mesh["extras"] = {k: v for k, v in extras.items() if k != "targetNames"}
            if not mesh["extras"]:
                del mesh["extras"]

    def put_nodes(self, skin: int, added: list[dict[str, Any]]) -> None:
        """Add the node of a skeleton at the top of the scenes, and its joints after it."""
        nodes = self.json["nodes"]
        top = len(nodes)
        nodes.extend(added)
        replaced = self.replaced()
        for scene in self.json.get("scenes", []):
            if replaced & self._below(scene.get("nodes", [])):
                scene["nodes"].append(top)
        for node in replaced:
            nodes[node]["skin"] = skin
            if any(part.node == node and part.skin is None for part in self.parts):
                self._turn_round(node)

    def _turn_round(self, node: int) -> None:
        """Take a mesh out from under a transform that mirrors or flattens it.

        A skinned mesh does not follow its node, but some engines still ask the node which side
        of a triangle is the front, or invert its transform.
        """
        if self._determinant(node) > 0:
            return
        nodes = self.json["nodes"]
        holder = nodes[node]
        if holder.get("children") or holder.get("camera") or holder.get("extensions"):
            nodes.append({k: holder[k] for k in ("name", "mesh", "skin") if k in holder})
            del holder["mesh"], holder["skin"]
            place = len(nodes) - 1
        else:
            place = node
            for key in ("matrix", *_MOTION):
                holder.pop(key, None)
            for parent in nodes:
                if node in parent.get("children", []):
                    parent["children"].remove(node)
                    if not parent["children"]:
                        del parent["children"]
        for scene, before in zip(
            self.json.get("scenes", []), self.document.items("scenes"), strict=True
        ):
            if node in self._below(before.get("nodes", []), self.document.items("nodes")):
                scene["nodes"] = [*scene["nodes"], *({place} - set(scene["nodes"]))]
        self.notes.append(f"the mesh of node {node} left a transform that mirrors it")

    def _below(self, roots: Sequence[int], nodes: list[Any] | None = None) -> set[int]:
        nodes = self.json["nodes"] if nodes is None else nodes
        seen: set[int] = set()
        stack = list(roots)
        while stack:
            node = stack.pop()
            if node not in seen:
                seen.add(node)
                stack.extend(nodes[node].get("children", []))
        return seen

    def start_of(self, clip: str) -> tuple[int, float] | None:
        """Number and first time in seconds of the file's clip of that name."""
        if not self.document.items("animations"):
            return None
        names = [self.clip_names.get(n, n) for n in names_of_clips(self.document)]
        if clip not in names:
            return None
        number = names.index(clip)
        return number, float(self.clips[number].times[0])

    def finish(self, kept_clips: set[int]) -> None:
        """Take out what served the replaced meshes alone.

        Parameters
        ----------
        kept_clips : set of int
            Numbers of the file's animations that the model has as clips.
        """
        json, original = self.json, self.document.json
        opaque = unknown_extensions(json)
        skins = used(original, "skins") - used(json, "skins")
        joints = self._joints_to_go(skins)
        self._drop_channels(joints, kept_clips)
        if opaque:
            self.notes.append(
                f"old joints and bytes are kept, as {', '.join(opaque)} may refer to them"
            )
            return
        extras = [k for k in joints if "extras" in json["nodes"][k]]
        if extras:
            self.lost.append(f"extras of {len(extras)} joints of the old skin")
        accessors = used(original, "accessors")
        views = used(original, "bufferViews")
        remove(json, "skins", skins)
        remove(json, "nodes", joints)
        gone = accessors - used(json, "accessors")
        remove(json, "accessors", gone)
        # An accessor that nothing used before is none of ours; its view is used by it.
        remove(json, "bufferViews", views - used(json, "bufferViews"))
        self.builder.compact = self.builder.compact or bool(gone)

    def _joints_to_go(self, skins: set[int]) -> set[int]:
        json = self.json
        listed = json.get("skins", [])
        old = {j for k in skins for j in listed[k]["joints"]}
        stay = {j for k, s in enumerate(listed) if k not in skins for j in s["joints"]}
        stay |= {s["skeleton"] for k, s in enumerate(listed) if k not in skins and "skeleton" in s}
        nodes = json["nodes"]
        going: set[int] = set()

        def goes(node: int) -> bool:
            item = nodes[node]
            below = [goes(child) for child in item.get("children", [])]  # each must be visited
            bare = not item.keys() & {"mesh", "camera", "extensions"} and node not in stay
            serves = node in old or (bool(below) and "extras" not in item)
            if bare and serves and all(below):
                going.add(node)
                return True
            return False

        children = {c for n in nodes for c in n.get("children", [])}
        for node in range(len(nodes)):
            if node not in children:
                goes(node)
        left = sorted(old - going - stay)
        if left:
            self.notes.append(
                f"{len(left)} joints of the old skin are kept as nodes, as others hang on them"
            )
        return going

    def _drop_channels(self, joints: set[int], kept_clips: set[int]) -> None:
        json = self.json
        replaced = self.replaced()
        meshes = {json["nodes"][n]["mesh"] for n in replaced if "mesh" in json["nodes"][n]}
        idle = {n for n in range(len(json["nodes"])) if self._serves_only(n, replaced)} | joints
        pointers = {f"/nodes/{n}/weights" for n in replaced} | {
            f"/meshes/{m}/weights" for m in meshes
        }
        if not json.get("animations"):
            return
        left = []
        for number, animation in enumerate(json["animations"]):
            channels, dropped = [], 0
            for channel in animation["channels"]:
                target = channel["target"]
                node, path = target.get("node"), target.get("path")
                pointed = target.get("extensions", {}).get("KHR_animation_pointer", {})
                to = str(pointed.get("pointer", ""))
                if (
                    (path == "weights" and node in replaced)
                    or (path in _MOTION and node in idle)
                    or any(to == p or to.startswith(f"{p}/") for p in pointers)
                ):
                    dropped += 1
                else:
                    channels.append(channel)
            ours = number in kept_clips or number >= len(self.document.items("animations"))
            if dropped and not ours:
                name = names_of_clips(self.document)[number]
                self.lost.append(f"the clip {name}, which the model does not have")
            if not dropped or channels:
                left.append(animation)
            if dropped and channels:
                _keep_channels(animation, channels)
        json["animations"] = left
        if not left:
            del json["animations"]

    def _serves_only(self, node: int, replaced: set[int]) -> bool:
        """True where a node moves nothing but replaced meshes."""
        below = self._below([node])
        nodes = self.json["nodes"]
        live = {j for s in self.json.get("skins", []) for j in s["joints"]}
        if below & live or not below & replaced:
            return False
        for k in below - replaced:
            if nodes[k].keys() & {"mesh", "camera", "extensions"} or not nodes[k].get("children"):
                return False
        return not any(nodes[k].keys() & {"camera", "extensions"} for k in below & replaced)


def _keep_channels(animation: dict[str, Any], channels: list[dict[str, Any]]) -> None:
    """Leave those channels of an animation, and the samplers that they need."""
    needed = sorted({channel["sampler"] for channel in channels})
    number = {old: new for new, old in enumerate(needed)}
    animation["samplers"] = [animation["samplers"][k] for k in needed]
    animation["channels"] = [{**c, "sampler": number[c["sampler"]]} for c in channels]


def open_template(path: Path, model: Skinning, meshes: Any = None) -> Template:
    """Read the file and see that the model is one of its meshes.

    Raises
    ------
    FormatError
        If the file cannot be read.
    InputError
        If the model has another number of vertices, or other triangles.
    """
    with reading(path):
        document = Document(path)
    wanted = check_meshes(document, meshes)
    with reading(path):
        clips = every(document)
        # Which side of a mirrored node is out is asked in the clip that was read first.
        named = [clip for clip in clips if clip.name == model.clips[0].name]
        world = World(document, (named or clips)[0])
        parts = read_parts(document, world, wanted)
        packed = any(
            "KHR_draco_mesh_compression" in document.dictionary(primitive, "extensions")
            for part in parts
            for primitive in document.item("meshes", part.mesh)["primitives"]
        )
        if packed:
            raise document.error("is compressed with Draco and cannot be a template")
        builder = Builder(document)
    starts = np.cumsum([0, *(len(part.vertex) for part in parts)])
    count = int(starts[-1])
    spread: NDArray[np.integer] = np.arange(count)
    if model.vertex_map is not None and len(model.vertex_map) == count:
        spread = model.vertex_map
    elif model.n_vertices != count:
        raise InputError("template", f"a file of {model.n_vertices} vertices", f"{count} in {path}")
    faces = np.concatenate([part.faces + k for part, k in zip(parts, starts[:-1], strict=True)])
    if not np.array_equal(spread[faces], model.faces):
        raise InputError("template", "a file with the model's triangles", str(path))
    return Template(document, world, clips, parts, builder, spread)
