"""Files ``.glb`` opened and packed by hand."""

from __future__ import annotations

import json
import struct

import numpy as np

KINDS = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def opened(path):
    """JSON and bytes of a file."""
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), bytearray(data[28 + size :])


def packed(path, document, binary):
    """Write a file of this JSON and these bytes; its path."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    total = 28 + len(text) + len(binary)
    head = struct.pack("<4sIII4s", b"glTF", 2, total, len(text), b"JSON")
    path.write_bytes(head + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary)
    return path


def rebuild(source, target, change):
    """Write a .glb anew after `change` has edited its JSON (and perhaps its buffer)."""
    document, binary = opened(source)
    change(document, binary)
    return packed(target, document, binary)


def values_of(document, binary, number):
    """Numbers of an accessor, (count, width)."""
    item = document["accessors"][number]
    view = document["bufferViews"][item["bufferView"]]
    kind, width = np.dtype(KINDS[item["componentType"]]), WIDTHS[item["type"]]
    start = view.get("byteOffset", 0) + item.get("byteOffset", 0)
    step = view.get("byteStride", kind.itemsize * width)
    return np.ndarray((item["count"], width), kind, binary, start, (step, kind.itemsize)).copy()
