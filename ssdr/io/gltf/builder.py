"""Building of a glTF document: accessors, joints, skin, clips, morph targets, and its file."""

from __future__ import annotations

import copy
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from ...common.errors import InputError
from ...mesh.clips import Clip
from ..atomic import write_bytes
from ..file_errors import check, reading
from ..played_model import PlayedModel
from ..signatures import picture_type
from .compression import MESHOPT
from .document import COMPONENTS, Document

CODES = {dtype.name: code for code, dtype in COMPONENTS.items()}
ARRAY, ELEMENTS = 34962, 34963


class Builder:
    """A glTF document to which accessors are added; it starts empty or as a copy of another.

    Parameters
    ----------
    document : Document, optional
        The document to copy. Its compressed buffer views are stored decompressed.

    Attributes
    ----------
    json : dict
        JSON of the file.
    blocks : list of bytes
        Bytes of each buffer view. Until the file is written, the field "buffer" of a view is an
        index into this list.
    lost : list of str
        Contents of the copied document that cannot be kept.
    notes : list of str
        Other messages for the user.
    """

    def __init__(self, document: Document | None = None) -> None:
        self.document = document
        self.notes: list[str] = []
        self.lost: list[str] = []
        self.json: dict[str, Any] = {"asset": {"version": "2.0", "generator": "ssdr"}, "scene": 0}
        self.blocks: list[memoryview | bytes | bytearray] = []
        if document is not None:
            self.json = copy.deepcopy(document.json)
            for number, view in enumerate(self.json.get("bufferViews", [])):
                view["buffer"] = number
                self.blocks.append(document.view(number)[0])
                if view.get("extensions", {}).keys() & set(MESHOPT):
                    del view["extensions"]
            whole = sum(item["byteLength"] for item in document.items("buffers"))
            problem = "its buffer views overlap so much that a copy would be many times larger"
            check(sum(map(len, self.blocks)) <= 16 * whole + (64 << 20), problem)
            for key in ("extensionsUsed", "extensionsRequired"):
                self.json[key] = [e for e in self.json.get(key, []) if e not in MESHOPT]
        for key in ("accessors", "bufferViews"):
            self.json.setdefault(key, [])

    def view(self, data: bytes | bytearray, **fields: Any) -> int:
        """Add a buffer view of `data` with the JSON `fields` and return its index."""
        views: list[Any] = self.json["bufferViews"]
        views.append({"buffer": len(self.blocks), **fields})
        self.blocks.append(data)
        return len(views) - 1

    def accessor(
        self,
        array: NDArray[Any],
        kind: str,
        *,
        target: int | None = None,
        bounds: bool = False,
        normalized: bool = False,
    ) -> int:
        """Add an accessor for `array` and return its index.

        `kind` is its type in glTF, such as "VEC3"; `target` states the use of its buffer view. With
        `bounds`, the accessor states the minimum and maximum of its values. With `normalized`,
        integers stand for numbers from 0 to 1.
        """
        fields = {} if target is None else {"target": target}
        view = self.view(np.ascontiguousarray(array).tobytes(), **fields)
        code = CODES[array.dtype.name]
        item = {"bufferView": view, "componentType": code, "count": len(array), "type": kind}
        if normalized and array.dtype.kind == "u":
            item["normalized"] = True
        if bounds:
            item |= _bounds(array)
        return self._put(item)

    def displaced(self, arrays: NDArray[Any]) -> list[int]:
        """Add accessors for what morph targets add to an attribute, and return their indices.

        An accessor is sparse where that takes fewer bytes. All sparse ones share two buffer views,
        since the JSON of a separate view is larger than the data of many targets.
        """
        wide = np.uint16 if arrays.shape[1] < 65536 else np.uint32
        index, values = bytearray(), bytearray()
        views: list[int] = []
        found: list[int] = []
        for stored in arrays.astype(np.float32):
            rows = np.flatnonzero(stored.any(axis=1)).astype(wide)
            if len(rows) * (3 * stored.itemsize + rows.itemsize) >= stored.nbytes:
                found.append(self.accessor(stored, "VEC3", target=ARRAY, bounds=True))
                continue
            item = {"componentType": CODES["float32"], "count": len(stored), "type": "VEC3"}
            item |= _bounds(stored)
            if len(rows):
                views = views or [self.view(index), self.view(values)]
                code, first = CODES[rows.dtype.name], {"bufferView": views[0]}
                item["sparse"] = {
                    "count": len(rows),
                    "indices": first | {"byteOffset": len(index), "componentType": code},
                    "values": {"bufferView": views[1], "byteOffset": len(values)},
                }
                # each array begins at a multiple of 4 bytes, as their types may differ
                index += rows.tobytes() + b"\0" * (-rows.nbytes % 4)
                values += stored[rows].tobytes()
            found.append(self._put(item))
        return found

    def _put(self, item: dict[str, Any]) -> int:
        """Add the JSON of an accessor and return its index."""
        accessors: list[Any] = self.json["accessors"]
        accessors.append(item)
        return len(accessors) - 1

    def save(self, path: Path) -> int:
        """Write a ``.glb``, or a ``.gltf`` with its ``.bin``, and return the number of bytes.

        Raises
        ------
        InputError
            If a ``.glb`` would be larger than its format allows.
        """
        self._embed_pictures(path)
        blocks: list[memoryview | bytes | bytearray] = []
        length = 0
        for view in self.json["bufferViews"]:
            block = self.blocks[view["buffer"]]
            view |= {"buffer": 0, "byteOffset": length, "byteLength": len(block)}
            blocks += [block, b"\0" * (-len(block) % 4)]
            length += len(block) + -len(block) % 4
        buffer: dict[str, Any] = {}
        if self.document is not None and self.document.items("buffers"):
            buffer = dict(self.document.items("buffers")[0])
        for key in ("uri", "extensions"):
            buffer.pop(key, None)
        buffer["byteLength"] = length
        self.json["buffers"] = [buffer] if length else []
        for key in ("accessors", "bufferViews", "buffers", "extensionsUsed", "extensionsRequired"):
            if not self.json.get(key, True):
                del self.json[key]
        if path.suffix.lower() == ".gltf":
            sidecar, size = path.with_suffix(".bin"), 0
            if length:
                buffer["uri"] = quote(sidecar.name)
                size = write_bytes(sidecar, b"".join(blocks))
            return size + write_bytes(path, json.dumps(self.json, indent=1).encode())
        text = json.dumps(self.json, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        total = 20 + len(text) + (8 + length if length else 0)
        if total > 0xFFFFFFFF:
            raise InputError("path", "a .gltf for more than 4 GiB", str(path))
        head = struct.pack("<4sIII4s", b"glTF", 2, total, len(text), b"JSON") + text
        if length:
            head += struct.pack("<I4s", length, b"BIN\0")
        return write_bytes(path, b"".join([head, *blocks]))

    def _embed_pictures(self, path: Path) -> None:
        """Copy separate picture files into the buffer, unless the output can refer to them.

        It can if `path` is a ``.gltf`` file in the folder of the document that was copied.
        """
        if self.document is None:
            return
        for image in self.json.get("images", []):
            uri = str(image.get("uri", "data:"))
            if uri.startswith("data:"):
                continue
            with reading(self.document.path):
                data = self.document.uri(uri, "an image")
            beside = path.parent.resolve() == self.document.path.parent.resolve()
            if path.suffix.lower() == ".glb" or not beside:
                del image["uri"]
                image.setdefault("mimeType", picture_type(data) or "image/png")
                image["bufferView"] = self.view(data)


def _bounds(array: NDArray[Any]) -> dict[str, Any]:
    """Smallest and largest values of an accessor, as JSON."""
    # Validators compare bounds exactly, and item() keeps a float32's value in JSON.
    flat = array.reshape(len(array), -1)
    ends = {"min": flat.min(axis=0), "max": flat.max(axis=0)}
    return {name: [x.item() for x in values] for name, values in ends.items()}


def add_weights(
    builder: Builder, played: PlayedModel, vertex: NDArray[np.integer]
) -> dict[str, int]:
    """Add the skin weights of the vertices `vertex` (N,) and return accessors by attribute.

    Each pair of attributes, ``JOINTS_k`` and ``WEIGHTS_k``, holds four influences of a vertex.
    """
    count = played.n_bones if played.moving is None else len(played.moving)
    narrow = np.uint8 if count <= 256 else np.uint16
    pad = ((0, 0), (0, -played.weights.shape[1] % 4))
    joints = np.pad(played.indices[vertex].astype(narrow), pad)
    weights = np.pad(played.weights[vertex], pad)
    attributes = {}
    for k in range(joints.shape[1] // 4):
        four = slice(4 * k, 4 * k + 4)
        for name, values in ((f"JOINTS_{k}", joints), (f"WEIGHTS_{k}", weights)):
            share = name.startswith("WEIGHTS")
            attributes[name] = builder.accessor(
                values[:, four], "VEC4", target=ARRAY, normalized=share
            )
    return attributes


def skeleton_nodes(played: PlayedModel, title: str, first: int) -> list[dict[str, Any]]:
    """JSON of a skeleton's nodes: its root, which becomes node `first`, and then its joints."""
    parents = np.full(played.n_bones, -1) if played.parents is None else played.parents
    nodes: list[dict[str, Any]] = [{"name": f"{title}_skeleton"}]
    for bone, name in enumerate(played.names):
        nodes.append({"name": name, "translation": [float(str(x)) for x in played.offsets[bone]]})
    for place, node in enumerate(nodes):
        children = first + 1 + np.flatnonzero(parents == place - 1)
        if len(children):
            node["children"] = children.tolist()
    return nodes


def add_skin(builder: Builder, played: PlayedModel, title: str, first: int) -> dict[str, Any]:
    """Add the inverse bind matrices of a skeleton and return the JSON of its skin.

    The skeleton's root is node `first` of the file, and its joints are the nodes that follow.
    """
    moving = np.arange(played.n_bones) if played.moving is None else played.moving
    inverse = np.tile(np.eye(4, dtype=np.float32), (len(moving), 1, 1))
    # glTF stores matrices column by column, so that rows here are the columns of the matrix.
    inverse[:, 3, :3] = -played.centers[moving]
    return {
        "name": title,
        "inverseBindMatrices": builder.accessor(inverse.reshape(-1, 16), "MAT4"),
        "skeleton": first,
        "joints": (first + 1 + moving).tolist(),
    }


def _moved(played: PlayedModel, clip: Clip) -> list[int]:
    """Indices of the bones that leave their rest transforms in a clip; bone 0 if none do."""
    some = clip.frames
    moved = (played.rotations[some] != np.array([0, 0, 0, 1])).any(axis=(0, 2))
    moved |= ((played.translations[some] != played.offsets).any(axis=2) & played.translating).any(
        axis=0
    )
    if played.scales is not None:
        moved |= (played.scales[some] != 1).any(axis=(0, 2))
    return np.flatnonzero(moved).tolist() or [0]


def add_animation(
    builder: Builder, played: PlayedModel, clip: Clip, name: str, first: int, start: float = 0.0
) -> dict[str, Any]:
    """Add the keys of a clip and return the JSON of its animation.

    The first frame of the clip is at `start` seconds; the skeleton's root is node `first`. Amounts
    of shapes are weights of node 0.
    """
    samplers: list[dict[str, Any]] = []
    channels: list[dict[str, Any]] = []
    inputs: dict[bytes, int] = {}

    def put(node: int, path: str, keys: NDArray[Any], values: NDArray[Any], kind: str) -> None:
        if keys.tobytes() not in inputs:
            times = (start + (keys - clip.start) / clip.fps).astype(np.float32)
            inputs[keys.tobytes()] = builder.accessor(times, "SCALAR", bounds=True)
        channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
        output = builder.accessor(values, kind)
        samplers.append({"input": inputs[keys.tobytes()], "output": output})

    for bone in _moved(played, clip):
        keys, node = clip.start + np.flatnonzero(played.keys[clip.frames, bone]), first + 1 + bone
        if played.translating[bone]:
            put(node, "translation", keys, played.translations[keys, bone], "VEC3")
        put(node, "rotation", keys, played.rotations[keys, bone], "VEC4")
        if played.scales is not None and (played.scales[:, bone] != 1).any():
            put(node, "scale", keys, played.scales[keys, bone], "VEC3")
    if played.shapes is not None:
        amounts = played.shapes.amounts[clip.frames].reshape(-1)
        put(0, "weights", np.arange(clip.start, clip.stop), amounts, "SCALAR")
    stated: dict[str, Any] = {"fps": clip.fps, "frames": clip.n_frames}
    if start:
        stated["start"] = start
    return {"name": name, "samplers": samplers, "channels": channels, "extras": {"ssdr": stated}}
