"""Where two glTF files differ: their trees, with what numbers refer to in their place."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from ssdr.io.gltf.document import COMPONENTS, Document

# What a new skin on the meshes of a file is allowed to change.
NEW_SKIN = re.compile(
    r"(scenes/\d+|.*/children)/nodes?/\+\S*_skeleton$"
    r"|.*/[+-]?(skin|weights|mesh/[+-]?weights)$"
    r"|.*/mesh/primitives/\d+/[+-]?targets$"
    r"|.*/mesh/primitives/\d+/attributes/[+-]?(POSITION|NORMAL|TANGENT|(JOINTS|WEIGHTS)_\d)(/.*)?$"
    r"|.*/mesh/extras/-targetNames$"
    r"|drawn/[^/]+/-(translation|rotation|scale|matrix)$"  # a skin stands at the top of its scene
)


def tree(path):
    """The file as nested dictionaries without a number that refers to something."""
    document = Document(Path(path))
    json = document.json

    def accessor(number):
        item = dict(json["accessors"][number])
        for key in ("bufferView", "byteOffset", "sparse"):
            item.pop(key, None)
        code = json["accessors"][number]["componentType"]
        exact = COMPONENTS[code].kind == "u"
        values = document.accessor(number, item["type"], "it", integers=exact)
        item["values"] = hashlib.sha256(values.tobytes()).hexdigest()
        return item

    def attributes(numbers):
        return {name: accessor(number) for name, number in numbers.items()}

    look_up = {
        "attributes": attributes,
        "indices": accessor,
        "targets": lambda targets: [attributes(t) for t in targets],
        "material": lambda number: json["materials"][number].get("name"),
    }

    def mesh(number):
        item = dict(json["meshes"][number])
        item["primitives"] = {
            str(k): p | {key: look_up[key](p[key]) for key in look_up if key in p}
            for k, p in enumerate(item["primitives"])
        }
        return item

    places, drawn = {}, {}
    below = {"children", "camera"}

    def node(number, above):
        item = dict(json["nodes"][number])
        place = f"{above}/{item.get('name', number)}"
        places[number] = place
        if "mesh" in item:
            moved = () if item.keys() & below else ("translation", "rotation", "scale", "matrix")
            keys = {"mesh", "skin", "weights", *moved} & item.keys()
            drawn[str(item.get("name", number))] = {key: item.pop(key) for key in keys}
        if "camera" in item:
            item["camera"] = json["cameras"][item["camera"]]
        if "children" in item:
            item["children"] = {"node": nodes(item["children"], place)}
        return item

    def nodes(numbers, above):
        found = {str(json["nodes"][k].get("name", k)): node(k, above) for k in numbers}
        return {
            name: item for name, item in found.items() if name not in drawn or below & item.keys()
        }

    result = {k: v for k, v in json.items() if k not in ("accessors", "bufferViews", "nodes")}
    result.pop("buffers", None)
    result.pop("skins", None)
    result["scenes"] = {
        str(k): {**s, "nodes": nodes(s.get("nodes", []), "")}
        for k, s in enumerate(json.get("scenes", []))
    }
    # By their nodes, wherever these stand; a mesh may have become two.
    result.pop("meshes", None)
    result["drawn"] = {n: {**one, "mesh": mesh(one["mesh"])} for n, one in drawn.items()}
    result["images"] = [
        {k: v for k, v in image.items() if k not in ("uri", "bufferView", "mimeType")}
        | {"sha256": hashlib.sha256(document.picture(image)).hexdigest()}
        for image in json.get("images", [])
    ]
    result["animations"] = {
        str(a.get("name", k)): {
            **{key: v for key, v in a.items() if key not in ("samplers", "channels")},
            "channels": {
                f"{places.get(c['target'].get('node'))}:{c['target'].get('path')}": {
                    "how": a["samplers"][c["sampler"]].get("interpolation"),
                    "input": accessor(a["samplers"][c["sampler"]]["input"]),
                    "output": accessor(a["samplers"][c["sampler"]]["output"]),
                }
                for c in a["channels"]
            },
        }
        for k, a in enumerate(json.get("animations", []))
    }
    return result


def difference(before, after):
    """Places where the two files differ, ``+`` for what is new and ``-`` for what is gone."""
    found = []

    def walk(a, b, place):
        if isinstance(a, dict) and isinstance(b, dict):
            for key in [*a, *(k for k in b if k not in a)]:
                if key not in b:
                    found.append(f"{place}/-{key}")
                elif key not in a:
                    found.append(f"{place}/+{key}")
                else:
                    walk(a[key], b[key], f"{place}/{key}")
        elif a != b:
            found.append(place)

    walk(tree(before), tree(after), "")
    return [place.lstrip("/") for place in found]
