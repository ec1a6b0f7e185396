"""glTF files opened, made and packed by hand."""

from __future__ import annotations

import json
import struct

import numpy as np

KINDS = {5120: "<i1", 5122: "<i2", 5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def opened(path):
    """JSON and bytes of a file."""
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), bytearray(data[28 + size :])


def accessors_of(arrays):
    """Accessors, buffer views and bytes of arrays, in the order given.

    Integers in rows are normalised, those alone are not.
    """
    codes = {np.dtype(kind): code for code, kind in KINDS.items()}
    kinds = {width: kind for kind, width in WIDTHS.items()}
    accessors, views, binary = [], [], b""
    for number, values in enumerate(map(np.asarray, arrays)):
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": values.nbytes})
        binary += values.tobytes() + b"\0" * (-values.nbytes % 4)
        item = {"bufferView": number, "componentType": codes[values.dtype], "count": len(values)}
        item["type"] = kinds[values[0].size]
        item["normalized"] = values.dtype.kind != "f" and values.ndim > 1
        accessors.append(item)
    return {"accessors": accessors, "bufferViews": views}, binary


def hand_made(path, document, *arrays):
    """Write a .gltf of this JSON and an accessor for each array, its bytes beside it; its path."""
    parts, data = accessors_of(arrays)
    path.with_name(f"{path.stem}-data.bin").write_bytes(data)
    buffers = [{"byteLength": len(data), "uri": f"{path.stem}-data.bin"}]
    path.write_text(
        json.dumps(parts | {"asset": {"version": "2.0"}, "buffers": buffers} | document)
    )
    return path


def rebuild(source, target, change):
    """Write a .glb anew after `change` has edited its JSON (and perhaps its buffer); its path."""
    document, binary = opened(source)
    change(document, binary)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    total = 28 + len(text) + len(binary)
    head = struct.pack("<4sIII4s", b"glTF", 2, total, len(text), b"JSON")
    target.write_bytes(head + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary)
    return target


def values_of(document, binary, number):
    """Numbers of an accessor, (count, width)."""
    item = document["accessors"][number]
    kind, width = np.dtype(KINDS[item["componentType"]]), WIDTHS[item["type"]]

    def rows(place, kind, width, count):
        view = document["bufferViews"][place["bufferView"]]
        start = view.get("byteOffset", 0) + place.get("byteOffset", 0)
        step = view.get("byteStride", kind.itemsize * width)
        return np.ndarray((count, width), kind, binary, start, (step, kind.itemsize)).copy()

    values = np.zeros((item["count"], width), kind)
    if "bufferView" in item:
        values = rows(item, kind, width, item["count"])
    if "sparse" in item:
        sparse, index = item["sparse"], np.dtype(KINDS[item["sparse"]["indices"]["componentType"]])
        where = rows(sparse["indices"], index, 1, sparse["count"])[:, 0]
        assert (np.diff(where.astype(int)) > 0).all()  # as the specification wants
        values[where] = rows(sparse["values"], kind, width, sparse["count"])
    return values
