"""Numbers by which items of a glTF document refer to each other, and how to remove items."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal

__all__ = ["Kind", "remove", "unknown_extensions", "used"]

Kind = Literal["nodes", "skins", "accessors", "bufferViews"]

# Every place that holds such a number; * stands for each entry of a list or object.
_PLACES: dict[Kind, str] = {
    "nodes": """scenes/*/nodes/* nodes/*/children/* skins/*/joints/* skins/*/skeleton
        animations/*/channels/*/target/node""",
    "skins": "nodes/*/skin",
    "accessors": """meshes/*/primitives/*/indices meshes/*/primitives/*/attributes/*
        meshes/*/primitives/*/targets/*/* skins/*/inverseBindMatrices
        animations/*/samplers/*/input animations/*/samplers/*/output
        nodes/*/extensions/EXT_mesh_gpu_instancing/attributes/*""",
    "bufferViews": """accessors/*/bufferView accessors/*/sparse/indices/bufferView
        accessors/*/sparse/values/bufferView images/*/bufferView
        meshes/*/primitives/*/extensions/KHR_draco_mesh_compression/bufferView""",
}
# Beginnings of extensions that refer to none of these, or in a way that stands in the table.
_KNOWN = """EXT_mesh_gpu_instancing EXT_meshopt_ EXT_texture_ KHR_draco_mesh_compression
    KHR_lights_punctual KHR_materials_ KHR_mesh KHR_node_visibility KHR_texture_ KHR_xmp"""


def unknown_extensions(json: dict[str, Any]) -> list[str]:
    """Extensions that may refer to items by number, so that none must be renumbered."""
    known = tuple(_KNOWN.split())
    return [str(e) for e in json.get("extensionsUsed", []) if not str(e).startswith(known)]


def _slots(item: Any, keys: list[str]) -> Iterator[tuple[Any, Any]]:
    """The lists or objects at the end of a path, each with the index or key of a number in it."""
    found = [keys[0]] if keys[0] in item else []
    if keys[0] == "*":
        found = list(range(len(item)) if isinstance(item, list) else item)
    for key in found:
        if len(keys) > 1:
            yield from _slots(item[key], keys[1:])
        else:
            yield item, key


def _references(json: dict[str, Any], kind: Kind) -> Iterator[tuple[Any, Any]]:
    for path in _PLACES[kind].split():
        yield from _slots(json, path.split("/"))


def used(json: dict[str, Any], kind: Kind) -> set[int]:
    """Numbers of the items that something refers to."""
    return {holder[key] for holder, key in _references(json, kind)}


def remove(json: dict[str, Any], kind: Kind, dead: set[int]) -> None:
    """Remove items to which nothing refers (nodes: also from lists); renumber the others."""
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
    for holder, key in _references(json, kind):
        holder[key] = number[holder[key]]
    json[kind] = [json[kind][k] for k in left]
    if not left:
        del json[kind]
