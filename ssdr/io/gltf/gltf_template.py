"""Writing of a model into the glTF file that its mesh came from; all else in the file is kept.

The file is read again when the model is written, so that a model need not hold its contents. Two
things are replaced: the vertex attributes that skinning needs, and the skins, joints and keys that
moved nothing but the model's meshes.
"""

from __future__ import annotations

import collections
import copy
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import InputError
from ...mesh.normals import corner_normals
from ...mesh.surface import Surface
from ...model.skinning import Skinning
from ..file_errors import check, reading
from ..played_model import PlayedModel
from ..sampling import part_starts
from ..scene import join_faces
from .animation import Nodes, descendants, read_animations
from .builder import ARRAY, ELEMENTS, Builder, add_animation, add_skin, add_weights, skeleton_nodes
from .compression import DRACO
from .document import Document
from .numbering import remove, remove_unused, unknown_extensions, used
from .primitives import PrimitiveGroup, read_parts, triangles

_LINES = (1, 2, 3)
_CONTENT = {"mesh", "camera", "extensions"}  # a node with one of these is more than a joint


def template_problem(path: Path) -> str:
    """Reason why a readable file cannot be a template, empty if it can."""
    with reading(path):
        return _problem(Document(path))


def _problem(document: Document) -> str:
    compressed = DRACO in document.items("extensionsUsed")
    return "its geometry is compressed with Draco" if compressed else ""


class Template:
    """A glTF file in which a model replaces the meshes that it was made from.

    Parameters
    ----------
    path : Path
    model : Skinning
    meshes : str or several of them, optional
        Names of the meshes that are replaced; all by default.
    clip_names : mapping
        Maps the name of a clip in the file to its name in the model, where these differ, or to None
        if the clip is left out on purpose.

    Attributes
    ----------
    builder : Builder
        The file as it will be written.

    Raises
    ------
    FormatError
        If the file cannot be read or is compressed with Draco.
    InputError
        If the model has other triangles or another number of vertices than the file, or a name in
        `meshes` is that of no mesh.
    """

    def __init__(
        self, path: Path, model: Skinning, meshes: Any, clip_names: Mapping[str, str | None]
    ) -> None:
        with reading(path, "meshes"):
            self.document = document = Document(path)
            problem = _problem(document)
            check(not problem, f"{problem}; it cannot be a template")
            animations = read_animations(document)
            # The model's first clip decides whether a node mirrors its mesh.
            first = model.clips[0].name
            named = [one for one in animations if clip_names.get(one.name, one.name) == first]
            self.world = Nodes(document, (named or animations)[0])
            self.parts = read_parts(document, self.world, meshes)
            self.builder = Builder(document)
        self.json = self.builder.json
        self.model, self.vertices = model, _model_vertices(self.parts, model, path)
        self.replaced = {part.node for part in self.parts}
        self.names = [one.name for one in animations if document.items("animations")]
        new_names = [clip_names.get(name, name) for name in self.names]
        # index and start in seconds of each clip of the file, by its name in the model
        self.clips = {
            name: (number, float(animations[number].times[0]))
            for number, name in enumerate(new_names)
        }
        self.missed = set(new_names) - {None, *(clip.name for clip in model.clips)}
        self.left: set[int] = set()  # nodes whose mesh was moved to a new node

    def put(self, played: PlayedModel, title: str) -> None:
        """Give the meshes the rest pose, skin and clips of a model; `title` names its skeleton."""
        with reading(self.document.path):
            self._put_meshes(played)
            first = self._put_skeleton(played, title)
            skins = used(self.document.json, "skins") - used(self.json, "skins")
            joints = self._unneeded_nodes(skins)
            self._remove_channels(joints)
            self._put_clips(played, title, first)
            self._remove_old(skins, joints)

    def _put_meshes(self, played: PlayedModel) -> None:
        """Replace rest pose, normals and skin weights of each part; remove its morph targets."""
        nodes, meshes = self.json["nodes"], self.json["meshes"]
        uses = collections.Counter(node.get("mesh") for node in nodes)
        for node in sorted(self.replaced):
            mesh = nodes[node]["mesh"]
            if uses[mesh] > 1:
                uses[mesh] -= 1
                meshes.append(copy.deepcopy(meshes[mesh]))
                nodes[node]["mesh"] = len(meshes) - 1
        normals = _normals(self.parts, self.vertices, self.model, played.rest)
        for part, vertices, own in zip(self.parts, self.vertices, normals, strict=True):
            index = vertices[part.label]
            attributes = self._new_attributes(part, played.rest[index], own)
            attributes |= add_weights(self.builder, played, index)
            for place, old in part.primitives.items():
                primitive = meshes[nodes[part.node]["mesh"]]["primitives"][place]
                primitive["attributes"] = dict(attributes)
                primitive.pop("targets", None)
                if part.mirrored and primitive.get("mode", 4) != 0:
                    # The node mirrored the mesh and joints do not, so triangles are flipped.
                    faces = triangles(self.document, old, len(part.label))[:, ::-1]
                    flat = faces.reshape(-1).astype(np.uint16 if faces.max() < 65535 else np.uint32)
                    number = self.builder.accessor(flat, "SCALAR", target=ELEMENTS)
                    primitive |= {"indices": number, "mode": 4}
        for node in sorted(self.replaced):
            self._remove_morphs(node, meshes[nodes[node]["mesh"]])

    def _new_attributes(
        self, part: PrimitiveGroup, rest: NDArray[np.float32], normals: NDArray[np.float32]
    ) -> dict[str, int]:
        """Add accessors of a part's attributes in the pose `rest`, with the model's normals.

        Skin weights and tangents are left out.
        """
        document, builder = self.document, self.builder
        old = next(iter(part.primitives.values()))["attributes"]
        gone = "JOINTS_", "WEIGHTS_", "TANGENT"
        kept = {k: v for k, v in old.items() if not k.startswith(gone)}
        said = "tangents are left out: programs compute them of UVs and normals"
        if "TANGENT" in old and said not in builder.notes:
            builder.notes.append(said)
        kept["POSITION"] = builder.accessor(rest, "VEC3", target=ARRAY, bounds=True)
        if "NORMAL" in old:
            new = document.accessor(old["NORMAL"], "VEC3", "NORMAL").astype(np.float32)
            new[part.corners] = normals
            kept["NORMAL"] = builder.accessor(new, "VEC3", target=ARRAY)
        return kept

    def _remove_morphs(self, node: int, mesh: dict[str, Any]) -> None:
        """Remove the morph weights and target names of a mesh and its node, and the mesh's lines.

        The new skin would not move the lines. They are reported as lost.
        """
        solid = [p for p in mesh["primitives"] if p.get("mode", 4) not in _LINES]
        if len(solid) < len(mesh["primitives"]):
            self.builder.lost.append(f"lines of the mesh {mesh.get('name') or f'of node {node}'}")
            mesh["primitives"] = solid
        mesh.pop("weights", None)
        self.json["nodes"][node].pop("weights", None)
        extras = mesh.get("extras")
        if isinstance(extras, dict) and extras.pop("targetNames", None) and not extras:
            del mesh["extras"]

    def _put_skeleton(self, played: PlayedModel, title: str) -> int:
        """Add the skin and the nodes of its skeleton, and return the index of the skeleton's root.

        The root is put at the top of every scene with a replaced mesh. The nodes of the joints
        follow the root in the file.
        """
        nodes, first = self.json["nodes"], len(self.json["nodes"])
        nodes.extend(skeleton_nodes(played, title, first))
        skins = self.json.setdefault("skins", [])
        skins.append(add_skin(self.builder, played, title, first))
        for scene in self.json.get("scenes", []):
            if self.replaced.intersection(descendants(nodes, scene.get("nodes", []))):
                scene["nodes"].append(first)
        turned = {part.node for part in self.parts if part.mirrored}
        for node in sorted(self.replaced):
            nodes[node]["skin"] = len(skins) - 1
            size = np.linalg.det(self.world.matrices(node)[0, :3, :3])
            if node in turned or size <= 0 or list(self.world.ancestors(node)):
                self._move_to_top(node)
            if node in turned:
                self.builder.notes.append(
                    f"the mesh of node {node} left a transform that mirrors it"
                )
        return first

    def _move_to_top(self, node: int) -> None:
        """Move the mesh of a node to a new node without a transform or a parent.

        A skinned mesh does not follow its node, but some engines still use the node's transform
        to tell the front of a triangle from its back, or invert it.
        """
        nodes = self.json["nodes"]
        holder = nodes[node]
        nodes.append({k: holder[k] for k in ("name", "mesh", "skin", "extras") if k in holder})
        for scene in self.json.get("scenes", []):
            if node in descendants(nodes, scene.get("nodes", [])):
                scene["nodes"].append(len(nodes) - 1)
        del holder["mesh"], holder["skin"]
        self.left.add(node)

    def _put_clips(self, played: PlayedModel, title: str, first: int) -> None:
        """Add the keys of each clip to the file's animation of its name, or to a new animation.

        A clip begins at 0 s or, if other tracks of its animation remain, where it began before.
        """
        animations = self.json.setdefault("animations", [])
        for clip in played.clips:
            number, start = self.clips.get(clip.name, (None, 0.0))
            old = {"channels": []} if number is None else animations[number]
            start = start if old["channels"] else 0.0
            if start:
                said = f"the clip {clip.name} begins at {start:g} s, as its other tracks do"
                self.builder.notes.append(said)
            made = add_animation(self.builder, played, clip, clip.name or title, first, start)
            if number is None:
                animations.append(made)
                continue
            if clip.name != self.names[number]:
                old["name"] = clip.name
            offset = len(old["samplers"])
            old["samplers"] += made["samplers"]
            old["channels"] += [{**c, "sampler": c["sampler"] + offset} for c in made["channels"]]
            if isinstance(old.setdefault("extras", {}), dict):
                old["extras"] |= made["extras"]
        self.json["animations"] = [one for one in animations if one["channels"]]

    def _remove_old(self, skins: set[int], joints: set[int]) -> None:
        """Remove skins, joints and bytes that only the replaced meshes used."""
        json, original = self.json, self.document.json
        opaque = unknown_extensions(json)
        if opaque:
            self.builder.notes.append(
                f"old joints and bytes are kept, as {', '.join(opaque)} may refer to them"
            )
            return
        extras = [k for k in joints - self.left if "extras" in json["nodes"][k]]
        if extras:
            self.builder.lost.append(f"extras of {len(extras)} joints of the old skin")
        remove(json, "skins", skins)
        remove(json, "nodes", joints)
        remove_unused(json, original)

    def _unneeded_nodes(self, skins: set[int]) -> set[int]:
        """Indices of nodes to remove: joints that only `skins` use, and parents of only such nodes.

        A note says how many joints must stay because other nodes are below them.
        """
        listed = self.json["skins"]
        old = {joint for k in skins for joint in listed[k]["joints"]} | self.left
        kept = [skin for k, skin in enumerate(listed) if k not in skins]
        needed = {joint for skin in kept for joint in skin["joints"]}
        needed |= {skin["skeleton"] for skin in kept if "skeleton" in skin}

        def bare(node: int, item: dict[str, Any]) -> bool:
            serves = node in old or (item.get("children") and "extras" not in item)
            return bool(serves and node not in needed and not item.keys() & _CONTENT)

        going = self._subtrees(bare)
        stuck = old - going - needed - self.left
        if stuck:
            self.builder.notes.append(
                f"{len(stuck)} joints of the old skin stay as nodes, as other nodes are below them"
            )
        return going

    def _remove_channels(self, joints: set[int]) -> None:
        """Remove the animation channels that moved nothing but the replaced meshes.

        They are channels of morph weights and of nodes, among these the removed `joints`. A clip
        that loses channels and is not in the model is reported as lost, unless it is left out on
        purpose.
        """
        idle = joints | self._idle_nodes()

        def serves_replaced(target: dict[str, Any]) -> bool:
            return target.get("node") in (
                self.replaced if target.get("path") == "weights" else idle
            )

        missed = {number for name, (number, _) in self.clips.items() if name in self.missed}
        for number, animation in enumerate(self.json.get("animations", [])):
            channels = [c for c in animation["channels"] if not serves_replaced(c["target"])]
            if len(channels) == len(animation["channels"]):
                continue
            if number in missed:
                lost = f"the clip {self.names[number]}, which the model does not have"
                self.builder.lost.append(lost)
            needed = sorted({channel["sampler"] for channel in channels})
            animation["samplers"] = [animation["samplers"][k] for k in needed]
            animation["channels"] = [{**c, "sampler": needed.index(c["sampler"])} for c in channels]

    def _idle_nodes(self) -> set[int]:
        """Indices of the nodes that move nothing but replaced meshes."""
        joints = {joint for skin in self.json["skins"] for joint in skin["joints"]}

        def bare(node: int, item: dict[str, Any]) -> bool:
            empty = item.get("children") and not item.keys() & _CONTENT
            if node in self.replaced:
                empty = not item.keys() & {"camera", "extensions"}
            return bool(empty and node not in joints)

        return self._subtrees(bare)

    def _subtrees(self, fits: Callable[[int, dict[str, Any]], bool]) -> set[int]:
        """Indices of the nodes that `fits` accepts together with all nodes below them."""
        nodes = self.json["nodes"]
        children = (n.get("children", []) for n in nodes)
        found: set[int] = set()
        for node in reversed(descendants(nodes, set(range(len(nodes))).difference(*children))):
            if fits(node, nodes[node]) and found.issuperset(nodes[node].get("children", [])):
                found.add(node)
        return found


def _model_vertices(
    parts: Sequence[PrimitiveGroup], model: Skinning, path: Path
) -> list[NDArray[np.integer]]:
    """For each part of a template file, the model vertex index of each of the part's vertices.

    `path` is the template file, for messages.

    Raises
    ------
    InputError
        If the template's number of vertices or its triangles differ from the model's.
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


def _normals(
    parts: Sequence[PrimitiveGroup],
    vertices: Sequence[NDArray[np.integer]],
    model: Skinning,
    rest: NDArray[np.floating],
) -> list[NDArray[np.float32]]:
    """For each part of a template file, the normals (T, 3, 3) of the model at its corners.

    A model without normals has those of its rest pose, with the hard edges of the file.

    Parameters
    ----------
    parts : sequence of PrimitiveGroup
    vertices : sequence of int arrays
        As :func:`_model_vertices` returns them.
    model : Skinning
    rest : (V, 3) array
        The model's rest pose, as it is written.
    """
    if model.surface is not None and model.surface.normals is not None:
        ends = np.cumsum([len(part.faces) for part in parts])
        return np.split(model.surface.normals, ends[:-1])
    return [
        corner_normals(rest[index], part.faces, Surface(normals=part.normals))
        for part, index in zip(parts, vertices, strict=True)
    ]
