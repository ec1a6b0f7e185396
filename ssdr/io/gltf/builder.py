"""A glTF document that grows, and how it becomes a file."""

from __future__ import annotations

import copy
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ..atomic import write_bytes
from .document import Document

__all__ = ["ARRAY", "ELEMENTS", "Builder"]

_COMPONENT = {"float32": 5126, "uint32": 5125, "uint16": 5123, "uint8": 5121}
ARRAY, ELEMENTS = 34962, 34963
_COMPRESSED = ("EXT_meshopt_compression", "KHR_meshopt_compression")


class Builder:
    """JSON and buffers: empty, or those of a file that is read, to which accessors are added.

    Parameters
    ----------
    document : Document, optional
        A file whose JSON and bytes are taken over as they are.
    """

    def __init__(self, document: Document | None = None) -> None:
        self.document = document
        self.sources: list[memoryview] = []
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "ssdr"},
            "scene": 0,
            "accessors": [],
            "bufferViews": [],
        }
        self.compact = False  # whether bytes that no view covers are left out
        self.blocks: list[bytes] = []
        self.length = 0
        if document is not None:
            self.json = copy.deepcopy(document.json)
            for key in ("accessors", "bufferViews"):
                self.json.setdefault(key, [])
            self._decompress(document)

    def _decompress(self, document: Document) -> None:
        """Views that are compressed become plain ones: their bytes cannot be cut or joined."""
        views = self.json["bufferViews"]
        packed = [
            k for k, view in enumerate(views) if set(view.get("extensions", {})) & set(_COMPRESSED)
        ]
        plain = {view["buffer"] for k, view in enumerate(views) if k not in packed}
        self.sources = [
            document.buffer(k) if not packed or k in plain else memoryview(b"")
            for k in range(len(document.items("buffers")))
        ]
        for k in packed:
            data, _ = document.view(k)
            of_place = ("buffer", "byteOffset", "byteLength", "extensions")
            rest = {key: value for key, value in views[k].items() if key not in of_place}
            views[k] = self._place(bytes(data)) | rest
            self.compact = True
        for key in ("extensionsUsed", "extensionsRequired") if packed else ():
            self.json[key] = [e for e in self.json.get(key, []) if e not in _COMPRESSED]
            if not self.json[key]:
                del self.json[key]

    def _place(self, data: bytes) -> dict[str, Any]:
        padding = -len(data) % 4
        # Until the buffers are merged, new bytes have one of their own, which has no number yet.
        view = {"buffer": None, "byteOffset": self.length, "byteLength": len(data)}
        self.blocks.append(data + b"\0" * padding)
        self.length += len(data) + padding
        return view

    def view(self, data: bytes, **fields: Any) -> int:
        views: list[Any] = self.json["bufferViews"]
        views.append(self._place(data) | {k: v for k, v in fields.items() if v is not None})
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
        item: dict[str, Any] = {
            "bufferView": self.view(np.ascontiguousarray(array).tobytes(), target=target),
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

    def save(self, path: Path) -> int:
        """Write the file with all that belongs to it; the number of bytes.

        Raises
        ------
        InputError
            If a ``.glb`` would be larger than its format allows, or a picture would replace
            another file beside a ``.gltf``.
        """
        pictures = self._pictures(path)
        binary = self._merged()
        buffer: dict[str, Any] = {}
        if self.document is not None:
            buffer = dict((self.document.items("buffers") or [{}])[0])
            buffer.pop("uri", None)
            buffer.pop("extensions", None)
        buffer["byteLength"] = len(binary)
        self.json.pop("buffers", None)
        for key in ("accessors", "bufferViews"):
            if not self.json[key]:
                del self.json[key]
        if binary:
            self.json["buffers"] = [buffer]
        if path.suffix.lower() == ".gltf":
            sidecar = path.with_suffix(".bin")
            size = sum(write_bytes(file, data) for file, data in pictures.items())
            if binary:
                buffer["uri"] = quote(sidecar.name)
                size += write_bytes(sidecar, binary)
            text = json.dumps(self.json, indent=1, allow_nan=False).encode()
            return size + write_bytes(path, text)
        text = json.dumps(self.json, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        binary += b"\0" * (-len(binary) % 4)
        body = struct.pack("<I4s", len(text), b"JSON") + text
        if binary:
            body += struct.pack("<I4s", len(binary), b"BIN\0") + binary
        total = 12 + len(body)
        if total > 0xFFFFFFFF:
            raise InputError("path", "a .gltf for more than 4 GiB", str(path))
        return write_bytes(path, struct.pack("<4sII", b"glTF", 2, total) + body)

    def _merged(self) -> bytes:
        """All buffers as one, the offsets of the views moved with their bytes."""
        blobs: dict[int | None, Any] = dict(enumerate(self.sources))
        blobs[None] = b"".join(self.blocks)
        parts: list[Any] = []
        length = 0
        for number, blob in blobs.items():
            views = [v for v in self.json["bufferViews"] if v["buffer"] == number]
            views.sort(key=lambda view: view.get("byteOffset", 0))
            spans = [(0, len(blob))] if not self.compact or number is None else _spans(views)
            for start, stop in spans:
                gap = (start - length) % 8  # alignment of what the views hold stays
                parts += [b"\0" * gap, blob[start:stop]]
                length += gap
                shift = length - start
                for view in views:
                    if start <= view.get("byteOffset", 0) < stop and view["buffer"] == number:
                        place = view.get("byteOffset", 0) + shift
                        if place or "byteOffset" in view:
                            view["byteOffset"] = place
                        view["buffer"] = -1
                length += stop - start
        for view in self.json["bufferViews"]:
            view["buffer"] = 0
        return b"".join(parts)

    def _pictures(self, path: Path) -> dict[Path, bytes]:
        """Put pictures into a ``.glb``; name those that must lie beside a ``.gltf``."""
        if self.document is None:
            return {}
        beside: dict[Path, bytes] = {}
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
                continue
            target = path.parent / unquote(uri)
            if target.exists():
                if target.read_bytes() != data:
                    raise InputError("path", "a folder without another picture", str(target))
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            beside[target] = data
        return beside


def _spans(views: list[dict[str, Any]]) -> list[tuple[int, int]]:
    """Ranges of bytes that some view covers, `views` in the order of their offsets."""
    spans: list[tuple[int, int]] = []
    for view in views:
        start = view.get("byteOffset", 0)
        stop = start + view["byteLength"]
        if spans and start <= spans[-1][1]:
            spans[-1] = spans[-1][0], max(stop, spans[-1][1])
        else:
            spans.append((start, stop))
    return spans
