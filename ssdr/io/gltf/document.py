"""A glTF file as checked JSON and checked arrays: nothing is allocated on the file's word alone."""

from __future__ import annotations

import base64
import binascii
import json
import math
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ..registry import describe
from .compression import DRACO, MESHOPT, decode_view, meshopt_of

__all__ = ["Document"]

_COMPONENTS: dict[int, np.dtype[Any]] = {
    5120: np.dtype("<i1"),
    5121: np.dtype("<u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
# bytes (1 GiB) of an accessor without a buffer: the file needs no data to claim any size
_ZEROS_LIMIT = 1 << 30
_KNOWN = {
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "KHR_lights_punctual",
    DRACO,
    *MESHOPT,
}


class Document:
    """The JSON of a ``.glb`` or ``.gltf`` and its buffers, read when they are needed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._folder = path.parent.resolve()
        self._buffers: dict[int, memoryview] = {}
        self._binary: memoryview | None = None
        self._decoded_views: dict[int, memoryview] = {}
        self._decoded: dict[int, NDArray[Any]] = {}  # of accessors
        data = path.read_bytes()
        if data[:4] == b"glTF":
            text, self._binary = self._chunks(data)
        elif path.suffix.lower() == ".glb":
            raise FormatError(f"{path}: not a binary glTF: {describe(data[:64])}")
        else:
            text = data
        try:
            self.json = json.loads(text.decode("utf-8-sig"), parse_constant=self._no_constant)
        except (UnicodeDecodeError, json.JSONDecodeError) as error:
            raise FormatError(f"{path}: not a glTF file ({error})") from error
        if not isinstance(self.json, dict):
            raise self.error("the JSON is not an object")
        version = str(self.dictionary(self.json, "asset").get("version", ""))
        if not version.startswith("2."):
            raise self.error(f"glTF version {version or 'missing'}; 2.0 is read")
        for extension in self.array(self.json, "extensionsRequired"):
            if extension not in _KNOWN and not str(extension).startswith("KHR_materials_"):
                raise self.error(
                    f"requires {extension}: that extension is not supported; save it without, "
                    "with Blender say"
                )

    def error(self, what: str) -> FormatError:
        return FormatError(f"{self.path}: {what}")

    def _no_constant(self, text: str) -> float:
        raise self.error(f"{text} is no JSON number")

    def _chunks(self, data: bytes) -> tuple[bytes, memoryview | None]:
        if len(data) < 20:
            raise self.error(f"truncated: {len(data)} bytes")
        version, total = struct.unpack_from("<II", data, 4)
        if version != 2:
            raise self.error(f"binary glTF version {version}; 2 is read")
        if total > len(data):
            raise self.error(f"truncated: states {total} bytes, holds {len(data)}")
        chunks: list[tuple[bytes, memoryview]] = []
        place = 12
        while place + 8 <= total:
            length, kind = struct.unpack_from("<I4s", data, place)
            if place + 8 + length > total:
                raise self.error(f"truncated: a chunk of {length} bytes at byte {place}")
            chunks.append((kind, memoryview(data)[place + 8 : place + 8 + length]))
            place += 8 + length + (-length % 4)
        if not chunks or chunks[0][0] != b"JSON":
            raise self.error("the first chunk is not JSON")
        binary = chunks[1][1] if len(chunks) > 1 and chunks[1][0] == b"BIN\0" else None
        return bytes(chunks[0][1]), binary

    def array(self, item: dict[str, Any], key: str) -> list[Any]:
        value = item.get(key, [])
        if not isinstance(value, list):
            raise self.error(f"{key} is not a list")
        return value

    def dictionary(self, item: dict[str, Any], key: str) -> dict[str, Any]:
        value = item.get(key, {})
        if not isinstance(value, dict):
            raise self.error(f"{key} is not an object")
        return value

    def integer(self, value: Any, what: str, limit: int | None = None, least: int = 0) -> int:
        if type(value) is not int or value < least or (limit is not None and value >= limit):
            upper = "" if limit is None else f" to {limit - 1}"
            raise self.error(f"{what} is {value!r}, not an integer from {least}{upper}")
        return value

    def number(self, value: Any, what: str) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(f"{what} is {value!r}, not a number")
        if not math.isfinite(float(value)):
            raise self.error(f"{what} is not finite")
        return float(value)

    def numbers(self, item: dict[str, Any], key: str, default: list[float]) -> NDArray[np.float64]:
        values = self.array(item, key) if key in item else default
        if len(values) != len(default):
            raise self.error(f"{key} has {len(values)} numbers, not {len(default)}")
        return np.array([self.number(v, key) for v in values], dtype=np.float64)

    def items(self, key: str) -> list[Any]:
        return self.array(self.json, key)

    def item(self, key: str, index: Any) -> dict[str, Any]:
        items = self.items(key)
        value = items[self.integer(index, f"an index into {key}", len(items))]
        if not isinstance(value, dict):
            raise self.error(f"{key}[{index}] is not an object")
        return value

    def uri(self, uri: Any, what: str) -> bytes:
        """Bytes behind a data URI, or a file that lies in the glTF's own folder."""
        if not isinstance(uri, str):
            raise self.error(f"the uri of {what} is no text")
        if uri.startswith("data:"):
            head, comma, body = uri.partition(",")
            if not comma or not head.endswith(";base64"):
                raise self.error(f"the data URI of {what} is not base64")
            try:
                return base64.b64decode(body, validate=True)
            except binascii.Error as error:
                raise self.error(f"the data URI of {what}: {error}") from error
        target = (self._folder / unquote(uri)).resolve()
        if "://" in uri or not target.is_relative_to(self._folder):
            raise self.error(f"{what} lies outside the file's folder: {uri[:200]!r}")
        if not target.is_file():
            raise self.error(f"{what} is missing: {uri[:200]!r}")
        return target.read_bytes()

    def buffer(self, index: int) -> memoryview:
        if index not in self._buffers:
            item = self.item("buffers", index)
            length = self.integer(item.get("byteLength"), "byteLength of a buffer", least=1)
            if "uri" in item:
                data = memoryview(self.uri(item["uri"], f"buffer {index}"))
            elif index == 0 and self._binary is not None:
                data = self._binary
            else:
                raise self.error(f"buffer {index} has neither a uri nor a binary chunk")
            if len(data) < length:
                raise self.error(f"buffer {index} states {length} bytes, holds {len(data)}")
            self._buffers[index] = data[:length]
        return self._buffers[index]

    def view(self, index: Any) -> tuple[memoryview, int | None]:
        """Bytes of a buffer view and its stride."""
        item = self.item("bufferViews", index)
        stride = item.get("byteStride")
        if stride is not None:
            stride = self.integer(stride, "byteStride", 253, least=4)
        packed = meshopt_of(self, item)
        if packed is not None:
            if index not in self._decoded_views:
                self._decoded_views[index] = decode_view(self, packed)
            return self._decoded_views[index], stride
        data = self.buffer(self.integer(item.get("buffer"), "buffer of a view"))
        start = self.integer(item.get("byteOffset", 0), "byteOffset of a view")
        length = self.integer(item.get("byteLength"), "byteLength of a view", least=1)
        if start + length > len(data):
            raise self.error(
                f"bufferView {index} ends at byte {start + length} of a buffer of {len(data)}"
            )
        return data[start : start + length], stride

    def accessor(
        self, index: Any, kinds: tuple[str, ...], what: str, *, integers: bool = False
    ) -> NDArray[Any]:
        """An accessor's numbers: ``(count,)`` or ``(count, width)``.

        Integers stay what they are where `integers`; else they become float64,
        normalised where the accessor says so.
        """
        item = self.item("accessors", index)
        kind = item.get("type")
        if kind not in kinds:
            raise self.error(f"{what} is {kind!r}, not {' or '.join(kinds)}")
        code = item.get("componentType")
        if code not in _COMPONENTS:
            raise self.error(f"{what} has the component type {code!r}")
        dtype, width = _COMPONENTS[code], _WIDTHS[str(kind)]
        if integers and dtype.kind != "u":
            raise self.error(f"{what} holds {dtype}, not unsigned integers")
        count = self.integer(item.get("count"), f"count of {what}", least=1)
        if index in self._decoded:
            values = self._fitting(self._decoded[index], dtype, width, count, what)
        elif "bufferView" in item:
            offset = self.integer(item.get("byteOffset", 0), f"byteOffset of {what}")
            values = self._strided(item["bufferView"], offset, dtype, width, count, what)
        else:
            if count * width * dtype.itemsize > _ZEROS_LIMIT:
                raise self.error(f"{what} states {count} elements and holds none")
            values = np.zeros((count, width), dtype=dtype)
        if "sparse" in item:
            values = self._sparse(self.dictionary(item, "sparse"), values, what)
        if not integers:
            plain = values.astype(np.float64)
            if dtype.kind != "f" and item.get("normalized"):
                plain = np.maximum(plain / np.iinfo(dtype).max, -1.0)
            values = plain
            if not np.isfinite(values).all():
                raise self.error(f"{what} holds NaN or Inf")
        return values[:, 0] if width == 1 else values

    def replace(self, index: Any, values: NDArray[Any], what: str) -> None:
        """Set the numbers of an accessor that another part of the file holds."""
        self.item("accessors", index)
        if index in self._decoded and not np.array_equal(self._decoded[index], values):
            raise self.error(f"{what}: two compressed meshes share one accessor")
        self._decoded[index] = values

    def _fitting(
        self, found: NDArray[Any], dtype: np.dtype[Any], width: int, count: int, what: str
    ) -> NDArray[Any]:
        values = found.reshape(len(found), -1)
        if values.shape != (count, width):
            raise self.error(f"{what}: decoded to {values.shape}, stated is {(count, width)}")
        plain = values.astype(dtype)
        if (values.dtype.kind == "f") != (dtype.kind == "f") or (plain != values).any():
            raise self.error(f"{what}: decoded to {values.dtype}, which {dtype} does not hold")
        return plain

    def _strided(
        self, view: Any, offset: int, dtype: np.dtype[Any], width: int, count: int, what: str
    ) -> NDArray[Any]:
        data, stride = self.view(view)
        size = dtype.itemsize * width
        step = size if stride is None else stride
        if step < size:
            raise self.error(f"{what}: a stride of {step} bytes for elements of {size}")
        if offset + step * (count - 1) + size > len(data):
            raise self.error(
                f"{what}: {count} elements of {size} bytes do not fit in a view of {len(data)}"
            )
        return np.ndarray((count, width), dtype, data, offset, (step, dtype.itemsize))

    def _sparse(self, sparse: dict[str, Any], values: NDArray[Any], what: str) -> NDArray[Any]:
        count = self.integer(sparse.get("count"), f"sparse count of {what}", len(values) + 1, 1)
        where, new = self.dictionary(sparse, "indices"), self.dictionary(sparse, "values")
        code = where.get("componentType")
        if code not in (5121, 5123, 5125):
            raise self.error(f"sparse indices of {what} have the component type {code!r}")
        offset = self.integer(where.get("byteOffset", 0), "byteOffset")
        rows = self._strided(
            where.get("bufferView"),
            offset,
            _COMPONENTS[code],
            1,
            count,
            f"sparse indices of {what}",
        )[:, 0]
        if int(rows.max()) >= len(values):
            raise self.error(f"sparse index {rows.max()} of {what}, which has {len(values)}")
        offset = self.integer(new.get("byteOffset", 0), "byteOffset")
        fresh = self._strided(
            new.get("bufferView"), offset, values.dtype, values.shape[1], count, what
        )
        values = values.copy()
        values[rows.astype(np.intp)] = fresh
        return values
