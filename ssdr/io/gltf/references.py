"""Which items of a glTF document refer to which, and how to take some of them out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal

__all__ = ["Kind", "remove", "unknown_extensions", "used"]

Kind = Literal["nodes", "skins", "accessors", "bufferViews"]

_Slot = tuple[Any, Any]  # a list or an object, and the place in it that holds the number

# Extensions that refer to none of the four kinds, or in a way that is known below.
_HARMLESS = (
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "KHR_xmp",
    "EXT_meshopt_",
    "KHR_mesh",
)
_KNOWN = {"KHR_lights_punctual", "KHR_node_visibility", "KHR_draco_mesh_compression"}
_INSTANCES = "EXT_mesh_gpu_instancing"


def unknown_extensions(json: dict[str, Any]) -> list[str]:
    """Extensions that may refer to items by number, so that none must be renumbered."""
    return [
        str(name)
        for name in json.get("extensionsUsed", [])
        if name not in _KNOWN and name != _INSTANCES and not str(name).startswith(_HARMLESS)
    ]


def _held(holder: Any, *keys: Any) -> Iterator[_Slot]:
    for key in keys:
        if key in holder:
            yield holder, key


def _slots(json: dict[str, Any], kind: Kind) -> Iterator[_Slot]:
    """Every place that holds a number of that kind."""
    if kind == "bufferViews":
        for accessor in json.get("accessors", []):
            yield from _held(accessor, "bufferView")
            for part in ("indices", "values"):
                if "sparse" in accessor:
                    yield from _held(accessor["sparse"][part], "bufferView")
        for image in json.get("images", []):
            yield from _held(image, "bufferView")
        for primitive in _primitives(json):
            packed = primitive.get("extensions", {}).get("KHR_draco_mesh_compression", {})
            yield from _held(packed, "bufferView")
    elif kind == "accessors":
        for primitive in _primitives(json):
            yield from _held(primitive, "indices")
            for attributes in (primitive["attributes"], *primitive.get("targets", [])):
                yield from _held(attributes, *attributes)
        for skin in json.get("skins", []):
            yield from _held(skin, "inverseBindMatrices")
        for animation in json.get("animations", []):
            for sampler in animation["samplers"]:
                yield from _held(sampler, "input", "output")
        for node in json.get("nodes", []):
            copies = node.get("extensions", {}).get(_INSTANCES, {}).get("attributes", {})
            yield from _held(copies, *copies)
    elif kind == "skins":
        for node in json.get("nodes", []):
            yield from _held(node, "skin")
    else:
        lists = [s["nodes"] for s in json.get("scenes", []) if "nodes" in s]
        lists += [n["children"] for n in json.get("nodes", []) if "children" in n]
        for skin in json.get("skins", []):
            lists.append(skin["joints"])
            yield from _held(skin, "skeleton")
        for animation in json.get("animations", []):
            for channel in animation["channels"]:
                yield from _held(channel["target"], "node")
        for numbers in lists:
            for place in range(len(numbers)):
                yield numbers, place


def _primitives(json: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for mesh in json.get("meshes", []):
        yield from mesh["primitives"]


def used(json: dict[str, Any], kind: Kind) -> set[int]:
    """Numbers of the items that something refers to."""
    return {holder[key] for holder, key in _slots(json, kind)}


def remove(json: dict[str, Any], kind: Kind, dead: set[int]) -> None:
    """Take items out to which nothing refers (nodes: also from lists); renumber the others."""
    if not dead:
        return
    if kind == "nodes":
        holders = [(s, "nodes") for s in json.get("scenes", [])]
        holders += [(n, "children") for n in json.get("nodes", [])]
        for holder, key in holders:
            if key in holder:
                holder[key] = [k for k in holder[key] if k not in dead]
                if not holder[key]:
                    del holder[key]
    left = [k for k in range(len(json[kind])) if k not in dead]
    number = {old: new for new, old in enumerate(left)}
    for holder, key in _slots(json, kind):
        holder[key] = number[holder[key]]
    json[kind] = [json[kind][k] for k in left]
    if not left:
        del json[kind]
