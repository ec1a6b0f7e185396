"""What of a glTF file a model holds, and the file passed on whole."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...clips import pick
from ..atomic import write_bytes
from ..registry import SaveReport, reading
from .animation import World, every, names_of_clips
from .builder import Builder
from .document import Document
from .mesh import check_meshes, read_parts
from .references import remove, unknown_extensions, used

__all__ = ["copy", "left_out", "template_problem"]

_MAPS = {
    "normalTexture": "normal maps",
    "occlusionTexture": "occlusion maps",
    "emissiveTexture": "emissive maps",
}


def copy(path: Path, target: Path, *, clips: Sequence[str | int] | None = None) -> SaveReport:
    """Write a glTF file again as ``.glb`` or ``.gltf`` with all that is in it.

    Parameters
    ----------
    path, target : Path
    clips : names or numbers, optional
        The animations to keep; all by default.

    Raises
    ------
    FormatError
        If the file cannot be read.
    InputError
        If it has no such clip.
    """
    with reading(path):
        document = Document(path)
        builder = Builder(document)
        names = names_of_clips(document)
        embedded = not any(
            "uri" in item and not str(item["uri"]).startswith("data:")
            for item in (*document.items("buffers"), *document.items("images"))
        )
    if clips is not None:
        kept = {pick(names, clip) for clip in clips}
        _keep_clips(builder, kept)
    elif embedded and path.suffix.lower() == target.suffix.lower() == ".glb":
        return SaveReport(path=target, bytes=write_bytes(target, path.read_bytes()))
    return SaveReport(path=target, bytes=builder.save(target))


def _keep_clips(builder: Builder, kept: set[int]) -> None:
    json = builder.json
    accessors, views = used(json, "accessors"), used(json, "bufferViews")
    if "animations" not in json:
        return
    json["animations"] = [a for k, a in enumerate(json["animations"]) if k in kept]
    if unknown_extensions(json):
        return
    remove(json, "accessors", accessors - used(json, "accessors"))
    remove(json, "bufferViews", views - used(json, "bufferViews"))
    builder.compact = True


def template_problem(path: Path) -> str:
    """Why a file that can be read cannot be a template; empty where it can."""
    with reading(path):
        used_there = Document(path).items("extensionsUsed")
    if "KHR_draco_mesh_compression" in used_there:
        return "its geometry is compressed with Draco"
    return ""


def left_out(path: Path, *, meshes: str | Sequence[str] | None = None) -> tuple[str, ...]:
    """What the file has and a sequence or skinning that is read from it has not."""
    with reading(path):
        document = Document(path)
    wanted = check_meshes(document, meshes)
    with reading(path):
        return tuple(_left_out(document, wanted))


def _left_out(document: Document, wanted: list[str] | None) -> list[str]:
    parts = read_parts(document, World(document, every(document)[0]), wanted)
    found: dict[str, None] = {}
    numbers = {part.mesh for part in parts}
    used_materials: set[int] = set()
    for number in sorted(numbers):
        mesh = document.item("meshes", number)
        for primitive in mesh["primitives"]:
            for name in primitive["attributes"]:
                if name.startswith("COLOR_"):
                    found["vertex colours"] = None
                elif name.startswith("TEXCOORD_") and name != "TEXCOORD_0":
                    found["further sets of UVs"] = None
                elif name.startswith("_") and name != "_VERTEX":
                    found[f"the attribute {name}"] = None
            if "material" in primitive:
                used_materials.add(primitive["material"])
    for number in sorted(used_materials):
        found |= dict.fromkeys(_of_material(document.item("materials", number)))
    if len({part.node for part in parts}) > 1:
        found["names and number of the meshes"] = None
    if any(part.has_axes(document) for part in parts):
        found["orientations of the joints"] = None
    for key, what in (("cameras", "cameras"), ("scenes", "scenes but the first")):
        if len(document.items(key)) > (key == "scenes"):
            found[what] = None
    lights = document.dictionary(document.dictionary(document.json, "extensions"), _LIGHTS)
    if lights:
        found["lights"] = None
    if wanted is not None:
        found["meshes that were not chosen"] = None
    if _has_extras(document.json):
        found["extras"] = None
    return list(found)


_LIGHTS = "KHR_lights_punctual"


def _of_material(material: dict[str, Any]) -> list[str]:
    found = [what for key, what in _MAPS.items() if key in material]
    look = material.get("pbrMetallicRoughness", {})
    if "metallicRoughnessTexture" in look:
        found.append("metallic-roughness maps")
    if "KHR_texture_transform" in look.get("baseColorTexture", {}).get("extensions", {}):
        found.append("transforms of textures")
    found += [f"material extension {name}" for name in material.get("extensions", {})]
    if material.get("alphaMode") == "MASK":
        found.append("alpha masks")
    return found


def _has_extras(value: Any) -> bool:
    if isinstance(value, dict):
        extras = value.get("extras")
        if "extras" in value and not (isinstance(extras, dict) and extras.keys() <= {"ssdr"}):
            return True
        return any(_has_extras(v) for k, v in value.items() if k != "extras")
    return isinstance(value, list) and any(_has_extras(v) for v in value)
