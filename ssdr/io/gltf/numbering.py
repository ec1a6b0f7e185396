"""Checks of the indices by which items of a glTF document refer to each other, and renumbering."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

# For each list of items, the paths of all fields that hold an index into it; * stands for each
# entry of a list or object.
_PLACES = {
    "scenes": "scene",
    "nodes": """scenes/*/nodes/* nodes/*/children/* skins/*/joints/* skins/*/skeleton
        animations/*/channels/*/target/node""",
    "meshes": "nodes/*/mesh",
    "skins": "nodes/*/skin",
    "materials": "meshes/*/primitives/*/material",
    "textures": "materials/*/pbrMetallicRoughness/baseColorTexture/index",
    "images": "textures/*/source",
    "accessors": """meshes/*/primitives/*/indices meshes/*/primitives/*/attributes/*
        meshes/*/primitives/*/targets/*/* skins/*/inverseBindMatrices
        animations/*/samplers/*/input animations/*/samplers/*/output
        nodes/*/extensions/EXT_mesh_gpu_instancing/attributes/*""",
    "bufferViews": """accessors/*/bufferView accessors/*/sparse/indices/bufferView
        accessors/*/sparse/values/bufferView images/*/bufferView
        meshes/*/primitives/*/extensions/KHR_draco_mesh_compression/bufferView""",
    "buffers": "bufferViews/*/buffer",
    "animations": "",
}
# Beginnings of the names of extensions that hold no indices except at the paths above.
_KNOWN = """EXT_mesh_gpu_instancing EXT_meshopt_ EXT_texture_ KHR_draco_mesh_compression
    KHR_lights_punctual KHR_materials_ KHR_mesh KHR_node_visibility KHR_texture_ KHR_xmp"""


# Properties to which channels of KHR_animation_pointer point, and which ordinary channels have.
_POINTER = re.compile(
    r"/(?:nodes/([0-9]{1,9})/(translation|rotation|scale|weights)|meshes/([0-9]{1,9})/weights)"
)


def pointer_of(target: dict[str, Any]) -> str:
    """What a channel's target points at by KHR_animation_pointer; empty if it does not."""
    return str(target.get("extensions", {}).get("KHR_animation_pointer", {}).get("pointer", ""))


def resolve_pointers(json: dict[str, Any]) -> None:
    """Replace pointers at what ordinary channels animate, too, by such channels.

    The weights of a mesh are those of all its nodes that have none of their own.
    """
    nodes = json.get("nodes", [])
    for animation in json.get("animations", []):
        channels: list[Any] = []
        for channel in animation.get("channels", []):
            found = _POINTER.fullmatch(pointer_of(channel["target"]))
            node, path, mesh = found.groups() if found else (None, None, None)
            chosen = [int(node)] if node is not None and int(node) < len(nodes) else []
            if mesh is not None:
                of_mesh = (k for k, one in enumerate(nodes) if one.get("mesh") == int(mesh))
                chosen = [k for k in of_mesh if "weights" not in nodes[k]]
            targets = [{"node": k, "path": path or "weights"} for k in chosen]
            # a pointer at nothing stays what it is: it is named as left out
            channels += [{**channel, "target": one} for one in targets] or [channel]
        animation["channels"] = channels


def check_numbers(json: dict[str, Any]) -> str:
    """Description of the first invalid list or index of a document, empty if all are valid."""
    for kind in _PLACES:
        items = json.get(kind, [])
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            return f"{kind} is not a list of objects"
    for kind in _PLACES:
        for holder, key in _references(json, kind):
            value, limit = holder[key], len(json.get(kind, []))
            if type(value) is not int or not 0 <= value < limit:
                return f"{key} {str(value)[:200]} is none of the {limit} {kind}"
    return ""


def unknown_extensions(json: dict[str, Any]) -> list[str]:
    """Extensions that could hold indices at unknown places, so that renumbering is unsafe."""
    known = tuple(_KNOWN.split())
    return [str(e) for e in json.get("extensionsUsed", []) if not str(e).startswith(known)]


def _slots(item: Any, keys: list[str]) -> Iterator[tuple[Any, Any]]:
    """Yield where indices stand: at the ends of all paths `keys` from `item`, "*" being any key.

    A place is a list or object, and the position or key at which it holds the index.
    """
    found: Any = [keys[0]] if keys[0] in item else []
    if keys[0] == "*":
        found = range(len(item)) if isinstance(item, list) else list(item)
    for key in found:
        if len(keys) > 1:
            yield from _slots(item[key], keys[1:])
        else:
            yield item, key


def _references(json: dict[str, Any], kind: str) -> Iterator[tuple[Any, Any]]:
    for path in _PLACES[kind].split():
        yield from _slots(json, path.split("/"))


def used(json: dict[str, Any], kind: str) -> set[int]:
    """Indices of the items of a kind (such as "nodes") to which a field of the document refers."""
    return {holder[key] for holder, key in _references(json, kind)}


def remove_unused(json: dict[str, Any], before: dict[str, Any]) -> None:
    """Remove accessors and buffer views that the document `before` used and `json` does not use.

    Items that are used in neither document stay.
    """
    for kind in ("accessors", "bufferViews"):
        remove(json, kind, used(before, kind) - used(json, kind))


def remove(json: dict[str, Any], kind: str, dead: set[int]) -> None:
    """Remove the items `dead` of a kind and renumber the others.

    Removed nodes are taken out of scenes and lists of children; no other field must refer to a
    removed item.
    """
    if not dead:
        return
    if kind == "nodes":
        holders = [(s, "nodes") for s in json.get("scenes", [])]
        holders += [(n, "children") for n in json.get("nodes", [])]
        for holder, key in holders:
            holder[key] = [k for k in holder.get(key, []) if k not in dead]
            if not holder[key]:
                del holder[key]
    left = [k for k in range(len(json[kind])) if k not in dead]
    number = {old: new for new, old in enumerate(left)}
    for holder, key in _references(json, kind):
        holder[key] = number[holder[key]]
    json[kind] = [json[kind][k] for k in left]
    if not left:
        del json[kind]
