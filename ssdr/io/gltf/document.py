"""A glTF file as checked JSON and checked arrays."""

from __future__ import annotations

import base64
import binascii
import json
import math
import struct
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ..references import is_inside
from ..registry import describe
from ..scene import SceneBudget
from .compression import DRACO, MESHOPT, decode_view

__all__ = ["COMPONENTS", "WIDTHS", "Document"]

_T = TypeVar("_T")
COMPONENTS: dict[int, np.dtype[Any]] = {
    5120: np.dtype("<i1"),
    5121: np.dtype("<u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_KNOWN = {
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "KHR_lights_punctual",
    DRACO,
    *MESHOPT,
}


class Document:
    """The JSON of a ``.glb`` or ``.gltf`` and its buffers, read when they are needed.

    Parameters
    ----------
    path : Path
    max_bytes : int, optional
        Memory that the file may ask for; see :class:`~ssdr.io.scene.SceneBudget`.
    """

    def __init__(self, path: Path, max_bytes: int | None = None) -> None:
        self.path = path
        self._buffers: dict[int, memoryview] = {}
        self._binary: memoryview | None = None
        self._decoded_views: dict[int, memoryview] = {}
        self._decoded: dict[int, NDArray[Any]] = {}  # accessors whose numbers Draco holds
        data = path.read_bytes()
        self.budget = SceneBudget(path, len(data), max_bytes)
        if data[:4] == b"glTF":
            data = self._json_chunk(data)
        elif path.suffix.lower() == ".glb":
            raise FormatError(f"{path}: not a binary glTF: {describe(data[:64])}")
        try:
            self.json = json.loads(
                data.decode("utf-8-sig"), parse_constant=self._finite, parse_float=self._finite
            )
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

    def _finite(self, text: str) -> float:
        if not math.isfinite(value := float(text)):
            raise self.error(f"the number {text} is not finite")
        return value

    def _json_chunk(self, data: bytes) -> bytes:
        """The JSON of a ``.glb``; its binary chunk is kept."""
        if len(data) < 20:
            raise self.error(f"truncated: {len(data)} bytes")
        version, total, length, kind = struct.unpack_from("<III4s", data, 4)
        if version != 2:
            raise self.error(f"binary glTF version {version}; 2 is read")
        if kind != b"JSON":
            raise self.error("the first chunk is not JSON")
        if total > len(data) or 20 + length > total:
            raise self.error(f"truncated: states {max(total, length)} bytes, holds {len(data)}")
        place = 20 + length + (-length % 4)
        if place + 8 <= total:
            size, kind = struct.unpack_from("<I4s", data, place)
            if place + 8 + size > total:
                raise self.error(f"truncated: a chunk of {size} bytes at byte {place}")
            if kind == b"BIN\0":
                self._binary = memoryview(data)[place + 8 : place + 8 + size]
        return data[20 : 20 + length]

    def array(self, item: dict[str, Any], key: str) -> list[Any]:
        return self._typed(item, key, list, "a list")

    def dictionary(self, item: dict[str, Any], key: str) -> dict[str, Any]:
        return self._typed(item, key, dict, "an object")

    def _typed(self, item: dict[str, Any], key: str, kind: type[_T], noun: str) -> _T:
        value = item.get(key, kind())
        if not isinstance(value, kind):
            raise self.error(f"{key} is not {noun}")
        return value

    def integer(self, value: Any, what: str, limit: int | None = None, least: int = 0) -> int:
        if type(value) is not int or value < least or (limit is not None and value >= limit):
            upper = "" if limit is None else f" to {limit - 1}"
            raise self.error(f"{what} is {repr(value)[:200]}, not an integer from {least}{upper}")
        return value

    def number(self, value: Any, what: str) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(f"{what} is {repr(value)[:200]}, not a number")
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
        """Bytes behind a data URI, or of a file in the glTF's own folder."""
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
        target = self.path.parent / unquote(uri)
        try:
            outside = "://" in uri or not is_inside(target, self.path.parent)
            missing = not target.is_file()  # nor is a pipe or a device
        except (OSError, ValueError, RuntimeError):  # a name that no file can have
            outside, missing = False, True
        if outside or missing:
            problem = "lies outside the file's folder" if outside else "is missing"
            raise self.error(f"{what} {problem}: {uri[:200]!r}")
        return target.read_bytes()

    def buffer(self, index: int) -> memoryview:
        if index not in self._buffers:
            item = self.item("buffers", index)
            length = self.integer(item.get("byteLength"), "byteLength of a buffer", least=1)
            if "uri" in item:
                data = memoryview(self.uri(item["uri"], f"buffer {index}"))
                self.budget.grow(len(data))
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
        packed = self._compression(item)
        if packed is None:
            return self._bytes(item, f"bufferView {index}"), stride
        if index not in self._decoded_views:
            count = self.integer(packed.get("count"), "count of a compressed view", least=1)
            width = packed.get("byteStride")
            width = self.integer(width, "byteStride of a compressed view", 257, least=1)
            self.budget.spend(count * width, f"bufferView {index}, decompressed,")
            self._decoded_views[index] = decode_view(
                bytes(self._bytes(packed, "compressed data")),
                count,
                width,
                str(packed.get("mode")),
                str(packed.get("filter", "NONE")),
                self.path,
            )
        return self._decoded_views[index], stride

    def _compression(self, view: dict[str, Any]) -> dict[str, Any] | None:
        """How a buffer view is compressed; None where it is not, or its plain bytes are there."""
        extensions = self.dictionary(view, "extensions")
        for name in MESHOPT:
            if name in extensions and name in self.array(self.json, "extensionsRequired"):
                return self.dictionary(extensions, name)
        return None

    def _bytes(self, item: dict[str, Any], what: str) -> memoryview:
        data = self.buffer(self.integer(item.get("buffer"), "buffer of a view"))
        start = self.integer(item.get("byteOffset", 0), "byteOffset of a view")
        length = self.integer(item.get("byteLength"), "byteLength of a view", least=1)
        if start + length > len(data):
            raise self.error(f"{what} ends at byte {start + length} of a buffer of {len(data)}")
        return data[start : start + length]

    def accessor(
        self, index: Any, kinds: tuple[str, ...], what: str, *, integers: bool = False
    ) -> NDArray[Any]:
        """Numbers of an accessor, ``(count,)`` or ``(count, width)``.

        They become float64, normalised where the accessor says so; with `integers`, they must be
        unsigned integers and stay what they are.
        """
        item = self.item("accessors", index)
        kind, code = item.get("type"), item.get("componentType")
        if kind not in kinds:
            raise self.error(f"{what} is {kind!r}, not {' or '.join(kinds)}")
        if code not in COMPONENTS:
            raise self.error(f"{what} has the component type {code!r}")
        dtype, width = COMPONENTS[code], WIDTHS[str(kind)]
        if integers and dtype.kind != "u":
            raise self.error(f"{what} holds {dtype}, not unsigned integers")
        count = self.integer(item.get("count"), f"count of {what}", least=1)
        self.budget.spend(8 * count * width, f"{what} of {count} elements")
        if index in self._decoded:
            values = self._fitting(self._decoded[index], dtype, width, count, what)
        elif "bufferView" in item:
            values = self._rows(item, dtype, width, count, what)
        else:
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

    def _rows(
        self, item: dict[str, Any], dtype: np.dtype[Any], width: int, count: int, what: str
    ) -> NDArray[Any]:
        """Elements of a view at which an accessor or a part of a sparse one begins."""
        data, stride = self.view(item.get("bufferView"))
        offset = self.integer(item.get("byteOffset", 0), f"byteOffset of {what}")
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
        rows = self._rows(where, COMPONENTS[code], 1, count, f"sparse indices of {what}")[:, 0]
        if int(rows.max()) >= len(values):
            raise self.error(f"sparse index {rows.max()} of {what}, which has {len(values)}")
        values = values.copy()
        values[rows.astype(np.intp)] = self._rows(new, values.dtype, values.shape[1], count, what)
        return values
