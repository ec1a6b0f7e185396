"""Open files of glTF 2.0, and their materials."""

from __future__ import annotations

import dataclasses
import logging
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...mesh.clips import Clip
from ...mesh.surface import METRES_Y_UP, Material
from ..sampling import Sample
from ..scene_file import SceneFile
from ..signatures import picture_type
from .animation import (
    Nodes,
    animated,
    animation_names,
    mesh_name,
    read_animation,
    read_animations,
    still_frame,
)
from .document import Document
from .numbering import pointer_of
from .primitives import JointPoints, PrimitiveGroup, names_of, read_parts

_log = logging.getLogger(__name__)
# Extensions, properties of materials and attributes that are read; all others are named.
_READ = re.compile(
    "|KHR_(mesh_quantization|draco_mesh_compression|node_visibility|animation_pointer)"
    "|(EXT|KHR)_meshopt_compression|name|extras|extensions|pbrMetallicRoughness|doubleSided"
    "|baseColor(Factor|Texture)|(metallic|roughness)Factor"
    "|POSITION|NORMAL|COLOR_0|TEXCOORD_0|(JOINTS|WEIGHTS)_.*|_VERTEX"
)


class GltfFile(SceneFile):
    """A glTF file; all its animations move the same parts."""

    space = METRES_Y_UP

    def __init__(self, path: Path, max_bytes: int | None = None, meshes: Any = None) -> None:
        self.document, self._wanted = Document(path, max_bytes), meshes
        self.budget = self.document.budget
        self.name, self.clip_names = mesh_name(self.document), animation_names(self.document)
        extras = [mesh.get("extras") for mesh in self.document.items("meshes")]
        stated = [one.get("ssdr") for one in extras if isinstance(one, dict)]
        self.driven = any(isinstance(one, dict) and one.get("driven") is True for one in stated)
        self._parts: Sequence[PrimitiveGroup] = ()

    def clips(self, fps: float | None) -> list[Clip]:
        return [one.clip for one in read_animations(self.document, fps)]

    def mesh_names(self) -> tuple[str, ...]:
        """Names of the meshes of the scene: that of the node, or else that of the mesh itself."""
        still = Nodes(self.document, still_frame())
        return tuple(dict.fromkeys(names_of(self.document, one)[0] for one in still.meshes))

    def left_out(self) -> list[str]:
        document, still = self.document, Nodes(self.document, still_frame())
        found = [f"{names_of(document, one)[0]} (hidden)" for one in still.hidden]
        if cameras := sum("camera" in still.items[node] for node in still.shown):
            found.append(f"{cameras} camera")
        channels = [one for item in document.items("animations") for one in item["channels"]]
        targets = [one["target"] for one in channels if not animated(one["target"])]
        looks = document.items("materials")
        primitives = [one for mesh in document.items("meshes") for one in mesh["primitives"]]
        held = set(map(pointer_of, targets)).union(document.items("extensionsUsed"), *looks)
        held.update(*(one.get("pbrMetallicRoughness", {}) for one in looks))
        held.update(*(one["attributes"] for one in primitives))
        return found + sorted(one for one in map(str, held) if not _READ.fullmatch(one))

    def sample(self, index: int, fps: float | None, joints_alone: bool = False) -> Sample:
        """Parts of the scene and the nodes that move them in one animation.

        If `joints_alone` and there are no meshes, there is one part, of the moving nodes.
        """
        document = self.document
        one = read_animation(document, index, fps, self.clip_names[index])
        frames = one.frames.within(self.asked)
        one = dataclasses.replace(one, frames=frames, times=frames.times)
        nodes = Nodes(document, one)
        if not self._parts:
            if joints_alone and not nodes.meshes:
                self._parts = [JointPoints(document)]
            else:
                self._parts = read_parts(document, nodes, self._wanted)

        def at(times: NDArray[np.float64]) -> Nodes:
            return Nodes(document, dataclasses.replace(one, times=times))

        return Sample(clip=one.clip, parts=self._parts, time=nodes, at=at, frames=one.frames)

    def materials(self, _parts: Sequence[Any]) -> list[Material]:
        return [_material(self.document, item) for item in self.document.items("materials")]


def _material(document: Document, item: dict[str, Any]) -> Material:
    look = item.get("pbrMetallicRoughness", {})
    r, g, b, a = document.numbers(look, "baseColorFactor", [1.0] * 4).tolist()
    texture, kind = None, "image/png"
    if "baseColorTexture" in look:
        reference = look["baseColorTexture"]
        if "KHR_texture_transform" in reference.get("extensions", {}):
            _log.warning("%s: the transform of a texture is left out", document.path)
        source = document.items("textures")[reference["index"]].get("source")
        if source is None:
            _log.warning("%s: a texture has no PNG or JPEG image", document.path)
        else:
            image = document.items("images")[source]
            texture = document.picture(image)
            kind = str(image.get("mimeType") or picture_type(texture) or kind)
    return Material(
        name=str(item.get("name", "material")),
        base_color=(r, g, b, a),
        metallic=document.number(look.get("metallicFactor", 1.0), "metallicFactor"),
        roughness=document.number(look.get("roughnessFactor", 1.0), "roughnessFactor"),
        double_sided=bool(item.get("doubleSided", False)),
        texture=texture,
        texture_type=kind,
    )
