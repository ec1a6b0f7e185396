"""Copying of glTF files, and a list of the contents that are lost when a file is read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...clips import pick
from ..atomic import write_bytes
from ..registry import SaveReport, reading
from .animation import Nodes, animation_names, read_animation
from .builder import Builder
from .compression import DRACO
from .document import Document
from .numbering import remove_unused, unknown_extensions
from .parts import read_parts


def copy(path: Path, target: Path, *, clips: Sequence[str | int] | None = None) -> SaveReport:
    """Copy a glTF file with all its contents, as ``.glb`` or ``.gltf``.

    Parameters
    ----------
    path, target : Path
    clips : names or indices, optional
        The animations to keep; all by default.

    Raises
    ------
    FormatError
        If the file cannot be read.
    InputError
        If the file has no such clip.
    """
    with reading(path, "clip"):
        document = Document(path)
        builder = Builder(document)
        named = (*document.items("buffers"), *document.items("images"))
        alone = all(str(item.get("uri", "data:")).startswith("data:") for item in named)
        if clips is not None:
            names = animation_names(document)
            _keep_clips(builder.json, document.json, {pick(names, clip) for clip in clips})
    if clips is None and alone and path.suffix.lower() == target.suffix.lower() == ".glb":
        return SaveReport(path=target, bytes=write_bytes(target, path.read_bytes()))
    return SaveReport(path=target, bytes=builder.save(target))


def _keep_clips(json: dict[str, Any], before: dict[str, Any], kept: set[int]) -> None:
    if "animations" in json:
        json["animations"] = [a for k, a in enumerate(json["animations"]) if k in kept]
        if not unknown_extensions(json):
            remove_unused(json, before)


def template_problem(path: Path) -> str:
    """Reason why a readable file cannot be a template of the writer, empty if it can."""
    with reading(path):
        compressed = DRACO in Document(path).items("extensionsUsed")
    return "its geometry is compressed with Draco" if compressed else ""


def left_out(path: Path, *, meshes: str | Sequence[str] | None = None) -> tuple[str, ...]:
    """Contents of a file that are lost when it is read as a sequence or skinning."""
    with reading(path, "meshes"):
        document = Document(path)
        parts = read_parts(document, Nodes(document, read_animation(document, 0)), meshes)
        parts.sort(key=lambda part: part.mesh)
        primitives = [p for part in parts for p in part.primitives.values()]
        found = [_of_attribute(name) for p in primitives for name in p["attributes"]]
        for number in sorted({p["material"] for p in primitives if "material" in p}):
            found += _of_material(document.items("materials")[number])
        json, scenes = document.json, document.items("scenes")
        lights = json.get("extensions", {}).get("KHR_lights_punctual")
        found += [
            what
            for what, there in {
                "names and number of the meshes": len({part.node for part in parts}) > 1,
                "orientations of the joints": any(part.has_axes for part in parts),
                "cameras": document.items("cameras"),
                "scenes but the first": len(scenes) > 1,
                "lights": lights,
                "meshes that were not chosen": meshes is not None,
                "extras": _has_extras(json),
            }.items()
            if there
        ]
        return tuple(dict.fromkeys(what for what in found if what))


def _of_attribute(name: str) -> str:
    if name.startswith("COLOR_"):
        return "vertex colours"
    if name.startswith("TEXCOORD_") and name != "TEXCOORD_0":
        return "further sets of UVs"
    return f"the attribute {name}" if name.startswith("_") and name != "_VERTEX" else ""


def _of_material(material: dict[str, Any]) -> list[str]:
    # normalTexture, occlusionTexture and emissiveTexture
    found = [f"{key.removesuffix('Texture')} maps" for key in material if key.endswith("Texture")]
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
    """Whether JSON holds extras that this package did not write."""
    if isinstance(value, dict):
        extras = value.get("extras", {})
        if not (isinstance(extras, dict) and extras.keys() <= {"ssdr"}):
            return True
        return any(_has_extras(v) for k, v in value.items() if k != "extras")
    return isinstance(value, list) and any(_has_extras(v) for v in value)
