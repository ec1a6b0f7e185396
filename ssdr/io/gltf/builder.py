"""A glTF document that grows, and how it becomes a file."""

from __future__ import annotations

import copy
import dataclasses
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ..atomic import write_bytes
from .compression import MESHOPT
from .document import Document

__all__ = ["ARRAY", "ELEMENTS", "Builder", "Encoded"]

_COMPONENT = {"float32": 5126, "uint32": 5125, "uint16": 5123, "uint8": 5121}
ARRAY, ELEMENTS = 34962, 34963


class Builder:
    """JSON and buffer views: none, or those of a file that is read, and what is added to them.

    Parameters
    ----------
    document : Document, optional
        A file whose JSON and bytes are taken over; compressed views become plain ones.
    """

    def __init__(self, document: Document | None = None) -> None:
        self.document = document
        self.json: dict[str, Any] = {"asset": {"version": "2.0", "generator": "ssdr"}, "scene": 0}
        # bytes of each view by the number in its field "buffer", until the file is written
        self.blocks: list[memoryview | bytes] = []
        if document is not None:
            self.json = copy.deepcopy(document.json)
            for number, view in enumerate(document.array(self.json, "bufferViews")):
                view["buffer"] = len(self.blocks)
                self.blocks.append(document.view(number)[0])
                document.budget.spend(len(self.blocks[-1]), "a copy of its buffer views")
                if document.dictionary(view, "extensions").keys() & set(MESHOPT):
                    del view["extensions"]
            for key in ("extensionsUsed", "extensionsRequired"):
                self.json[key] = [e for e in document.items(key) if e not in MESHOPT]
            for number in range(len(document.items("images"))):
                document.item("images", number)  # an object
        for key in ("accessors", "bufferViews"):
            self.json.setdefault(key, [])

    def view(self, data: bytes, **fields: Any) -> int:
        """Add a buffer view; its number."""
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
        normalized: bool = False,
        bounds: bool = False,
    ) -> int:
        """Add an accessor over a view of its own; its number."""
        fields = {} if target is None else {"target": target}
        item: dict[str, Any] = {
            "bufferView": self.view(np.ascontiguousarray(array).tobytes(), **fields),
            "componentType": _COMPONENT[array.dtype.name],
            "count": len(array),
            "type": kind,
        }
        if normalized:
            item["normalized"] = True
        if bounds:
            # float() of a float32 keeps its value in JSON; validators compare exactly.
            flat = array.reshape(len(array), -1)
            item["min"] = [float(x) for x in flat.min(axis=0)]
            item["max"] = [float(x) for x in flat.max(axis=0)]
        accessors: list[Any] = self.json["accessors"]
        accessors.append(item)
        return len(accessors) - 1

    def encode(self, path: Path) -> Encoded:
        """The file as bytes, with what belongs beside it."""
        pictures = self._pictures(path)
        blocks: list[memoryview | bytes] = []
        length = 0
        for view in self.json["bufferViews"]:
            block = self.blocks[view["buffer"]]
            view |= {"buffer": 0, "byteOffset": length, "byteLength": len(block)}
            blocks += [block, b"\0" * (-len(block) % 4)]
            length += len(block) + -len(block) % 4
        buffer: dict[str, Any] = {}
        if self.document is not None and self.document.items("buffers"):
            buffer = dict(self.document.item("buffers", 0))
        for key in ("uri", "extensions"):
            buffer.pop(key, None)
        buffer["byteLength"] = length
        self.json["buffers"] = [buffer] if length else []
        for key in ("accessors", "bufferViews", "buffers", "extensionsUsed", "extensionsRequired"):
            if not self.json.get(key, True):
                del self.json[key]
        if path.suffix.lower() == ".gltf":
            sidecar = path.with_suffix(".bin")
            files = {sidecar: b"".join(blocks)} if length else {}
            if length:
                buffer["uri"] = quote(sidecar.name)
            return Encoded(pictures, files | {path: json.dumps(self.json, indent=1).encode()})
        text = json.dumps(self.json, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        total = 20 + len(text) + (8 + length if length else 0)
        if total > 0xFFFFFFFF:
            raise InputError("path", "a .gltf for more than 4 GiB", str(path))
        head = struct.pack("<4sIII4s", b"glTF", 2, total, len(text), b"JSON") + text
        if length:
            head += struct.pack("<I4s", length, b"BIN\0")
        return Encoded(pictures, {path: b"".join([head, *blocks])})

    def _pictures(self, path: Path) -> dict[Path, bytes]:
        """Put pictures into a ``.glb``; those that must lie beside a ``.gltf``."""
        beside: dict[Path, bytes] = {}
        if self.document is None:
            return beside
        for image in self.json.get("images", []):
            uri = image.get("uri")
            if uri is None or str(uri).startswith("data:"):
                continue
            data = self.document.uri(uri, "an image")
            if path.suffix.lower() == ".glb":
                del image["uri"]
                jpeg = data.startswith(b"\xff\xd8\xff")
                image.setdefault("mimeType", "image/jpeg" if jpeg else "image/png")
                image["bufferView"] = self.view(data)
            else:
                beside[path.parent / unquote(uri)] = data
        return beside


@dataclasses.dataclass(frozen=True)
class Encoded:
    """Bytes of files: pictures that others may share, and the file's own."""

    pictures: dict[Path, bytes]
    files: dict[Path, bytes]

    def write(self) -> int:
        """Write all files; the number of bytes.

        Raises
        ------
        InputError
            If a picture would replace another file.
        """
        new = {file: data for file, data in self.pictures.items() if not file.is_file()}
        for file in self.pictures.keys() - new.keys():
            if file.read_bytes() != self.pictures[file]:
                raise InputError("path", "a folder without another picture", str(file))
        for file in new:
            file.parent.mkdir(parents=True, exist_ok=True)
        return sum(write_bytes(file, data) for file, data in (new | self.files).items())
