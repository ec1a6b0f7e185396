"""Reading of a glTF file's JSON and arrays, with checks of both."""

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

from ...common.errors import FormatError
from ..file_errors import SceneBudget, check
from ..references import HINT, OUTSIDE, locate
from ..signatures import describe
from .compression import DRACO, MESHOPT, decode_view
from .numbering import check_numbers, resolve_pointers

_KINDS = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
COMPONENTS: dict[int, np.dtype[Any]] = {k: np.dtype(f"<{kind}") for k, kind in _KINDS.items()}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_READ = (
    *("KHR_mesh_quantization", "KHR_texture_transform", "KHR_lights_punctual"),
    *("KHR_animation_pointer", "KHR_node_visibility"),
)
_READ_EXTENSIONS = (*_READ, "KHR_materials_", DRACO, *MESHOPT)


class Document:
    """The JSON of a ``.glb`` or ``.gltf`` file, with buffers that are read when they are needed.

    To be used inside :func:`~ssdr.io.file_errors.reading`, which adds the file's name to errors.

    When the file is opened, two things are checked: each list of items (nodes, meshes, ...) holds
    JSON objects, and each index of an item is in range. Other fields are not checked then.

    Parameters
    ----------
    path : Path
    max_bytes : int, optional
        Most memory that reading the file may take; see :class:`~ssdr.io.file_errors.SceneBudget`.
    """

    def __init__(self, path: Path, max_bytes: int | None = None) -> None:
        self.path = path
        self._buffers: dict[int, memoryview] = {}
        self._binary: memoryview | None = None
        self._decoded_views: dict[int, memoryview] = {}
        self._decoded: dict[int, NDArray[Any]] = {}  # values of accessors, from Draco data
        data = path.read_bytes()
        self.budget = SceneBudget(path, len(data), max_bytes)
        if data[:4] == b"glTF":
            data = self._json_chunk(data)
        elif path.suffix.lower() == ".glb":
            raise FormatError(f"not a binary glTF: {describe(data[:64])}")
        try:
            self.json = json.loads(
                data.decode("utf-8-sig"), parse_constant=self._finite, parse_float=self._finite
            )
        except (UnicodeDecodeError, json.JSONDecodeError) as error:
            raise FormatError(f"not a glTF file ({error})") from error
        check(isinstance(self.json, dict), "the JSON is not an object")
        asset = self.json.get("asset", {})
        version = str(asset.get("version", "missing"))
        check(version.startswith("2."), f"glTF version {version}; 2.0 is read")
        needed = str(asset.get("minVersion", "2.0"))
        check(needed == "2.0", f"the file asks for a reader of glTF {needed}; 2.0 is read")
        for extension in map(str, self.json.get("extensionsRequired", [])):
            problem = f"requires {extension}, which is not supported: save the file without it"
            check(extension.startswith(_READ_EXTENSIONS), problem)
        problem = check_numbers(self.json)
        check(not problem, problem)
        resolve_pointers(self.json)

    def _finite(self, text: str) -> float:
        value = float(text)
        check(math.isfinite(value), f"the number {text} is not finite")
        return value

    def _json_chunk(self, data: bytes) -> bytes:
        """Return the JSON chunk of a ``.glb``, and store its binary chunk as buffer 0."""
        check(len(data) >= 20, f"truncated: {len(data)} bytes")
        version, total, length, kind = struct.unpack_from("<III4s", data, 4)
        check(version == 2, f"binary glTF version {version}; 2 is read")
        check(kind == b"JSON", "the first chunk is not JSON")
        problem = f"truncated: states {max(total, length)} bytes, holds {len(data)}"
        check(20 + length <= total <= len(data), problem)
        place = 20 + length + (-length % 4)
        if place + 8 <= total:
            size, kind = struct.unpack_from("<I4s", data, place)
            check(place + 8 + size <= total, f"truncated: a chunk of {size} bytes at byte {place}")
            if kind == b"BIN\0":
                self._binary = memoryview(data)[place + 8 : place + 8 + size]
        return data[20 : 20 + length]

    def items(self, kind: str) -> list[Any]:
        """Top-level list `kind` of the JSON, such as "nodes"; empty if it is missing."""
        found: list[Any] = self.json.get(kind, [])
        return found

    def integer(self, item: dict[str, Any], key: str, what: str, least: int = 1) -> int:
        """Integer ``item[key]``, which must be at least `least`.

        If `least` is 0, a missing integer is 0; otherwise it must not be missing.
        """
        value: Any = item.get(key, None if least else 0)
        problem = f"{key} of {what} is {repr(value)[:200]}, not an integer >= {least}"
        check(type(value) is int and value >= least, problem)
        return int(value)

    def number(self, value: Any, what: str) -> float:
        check(type(value) in (int, float), f"{what} is {repr(value)[:200]}, not a number")
        return float(value)

    def numbers(self, item: dict[str, Any], key: str, default: list[float]) -> NDArray[np.float64]:
        """Numbers of the list ``item[key]``, or `default` if the list is missing.

        The list must have as many numbers as `default`.
        """
        values = item.get(key, default)
        check(len(values) == len(default), f"{key} has {len(values)} numbers, not {len(default)}")
        return np.array([self.number(value, key) for value in values], dtype=np.float64)

    def uri(self, uri: Any, what: str) -> bytes:
        """Bytes of a data URI, or of a file in the folder of the glTF file or below it."""
        check(isinstance(uri, str), f"the uri of {what} is no text")
        if uri.startswith("data:"):
            head, _, body = uri.partition(",")
            check(head.endswith(";base64"), f"the data URI of {what} is not base64")
            try:
                return base64.b64decode(body, validate=True)
            except binascii.Error as error:
                raise FormatError(f"the data URI of {what}: {error}") from error
        target, problem = locate(self.path, unquote(uri))
        hint = f" ({HINT})" if problem == OUTSIDE else ""
        problem = OUTSIDE if "://" in uri else problem
        check(not problem, f"{what} {problem}: {uri[:200]!r}{hint}")
        return target.read_bytes()

    def picture(self, image: dict[str, Any]) -> bytes:
        """Bytes of an image file (PNG or JPEG), from a buffer view or a URI."""
        if "bufferView" in image:
            return bytes(self.view(image["bufferView"])[0])
        return self.uri(image.get("uri"), "an image")

    def _buffer(self, index: int) -> memoryview:
        if index not in self._buffers:
            item = self.items("buffers")[index]
            length = self.integer(item, "byteLength", "a buffer")
            if "uri" in item:
                data = memoryview(self.uri(item["uri"], f"buffer {index}"))
                self.budget.grow(len(data))
            elif index == 0 and self._binary is not None:
                data = self._binary
            else:
                raise FormatError(f"buffer {index} has neither a uri nor a binary chunk")
            check(len(data) >= length, f"buffer {index} states {length} bytes, holds {len(data)}")
            self._buffers[index] = data[:length]
        return self._buffers[index]

    def view(self, index: int) -> tuple[memoryview, int | None]:
        """Bytes of a buffer view, decompressed, and its stride (None if it states none)."""
        item = self.items("bufferViews")[index]
        stride = self.integer(item, "byteStride", "a view") if "byteStride" in item else None
        extensions = item.get("extensions", {})
        required = self.json.get("extensionsRequired", [])
        # If the extension is not required, the file holds the bytes uncompressed as well.
        packed = next((extensions[e] for e in MESHOPT if e in extensions and e in required), None)
        if packed is None:
            return self._bytes(item, f"bufferView {index}"), stride
        if index not in self._decoded_views:
            count = self.integer(packed, "count", "a compressed view")
            width = self.integer(packed, "byteStride", "a compressed view")
            self.budget.spend(count * width, f"bufferView {index}, decompressed,")
            data = bytes(self._bytes(packed, "compressed data"))
            how = str(packed.get("mode")), str(packed.get("filter", "NONE"))
            self._decoded_views[index] = decode_view(data, count, width, *how, self.path)
        return self._decoded_views[index], stride

    def _bytes(self, item: dict[str, Any], what: str) -> memoryview:
        data = self._buffer(self.integer(item, "buffer", what, 0))
        start = self.integer(item, "byteOffset", what, 0)
        stop = start + self.integer(item, "byteLength", what)
        check(stop <= len(data), f"{what} ends at byte {stop} of a buffer of {len(data)}")
        return data[start:stop]

    def accessor(self, index: int, kind: str, what: str, *, integers: bool = False) -> NDArray[Any]:
        """Values of an accessor: ``(count,)`` for scalars, else ``(count, width)``.

        Values become float64, and are normalised if the accessor says so. With `integers`, they
        must be unsigned integers and keep their type. `kind` is the type that the accessor must
        have, such as "VEC3", or several that it may have; `what` names the values in errors.
        """
        item = self.items("accessors")[index]
        code = item.get("componentType")
        check(item.get("type") in kind.split(), f"{what} is {item.get('type')!r}, not {kind}")
        check(code in COMPONENTS, f"{what} has the component type {code!r}")
        dtype, width = COMPONENTS[code], WIDTHS[item["type"]]
        check(dtype.kind == "u" or not integers, f"{what} holds {dtype}, not unsigned integers")
        count = self.integer(item, "count", what)
        self.budget.spend(8 * count * width, f"{what} of {count} elements")
        values: NDArray[Any] = np.zeros((count, width), dtype=dtype)
        if index in self._decoded:
            found = self._decoded[index].reshape(len(self._decoded[index]), -1)
            problem = f"{what}: decoded to {found.shape}, stated is {values.shape}"
            check(found.shape == values.shape, problem)
            values = found.astype(dtype)
            same = (found.dtype.kind == "f") == (dtype.kind == "f") and (values == found).all()
            check(same, f"{what}: decoded to {found.dtype}, which {dtype} does not hold")
        elif "bufferView" in item:
            values = self._rows(item, dtype, width, count, what)
        if "sparse" in item:
            sparse = item["sparse"]
            values = values.copy()
            n_changed = self.integer(sparse, "count", f"sparse {what}")
            code = sparse["indices"].get("componentType")
            rows = self._rows(
                sparse["indices"], COMPONENTS[code], 1, n_changed, f"indices of sparse {what}"
            )
            problem = f"sparse index {rows.max()} of {what}, which has {count}"
            check(rows.dtype.kind == "u" and int(rows.max()) < count, problem)
            new = self._rows(sparse["values"], dtype, width, n_changed, f"sparse {what}")
            values[rows[:, 0].astype(np.intp)] = new
        if not integers:
            values = values.astype(np.float64)
            if dtype.kind != "f" and item.get("normalized"):
                values = np.maximum(values / np.iinfo(dtype).max, -1.0)
            check(np.isfinite(values).all(), f"{what} holds NaN or Inf")
        return values[:, 0] if width == 1 else values

    def replace(self, index: int, values: NDArray[Any], what: str) -> None:
        """Set the values of an accessor whose data the file holds only in compressed form."""
        same = index not in self._decoded or np.array_equal(self._decoded[index], values)
        check(same, f"{what}: two compressed meshes share one accessor")
        self._decoded[index] = values

    def _rows(
        self, item: dict[str, Any], dtype: np.dtype[Any], width: int, count: int, what: str
    ) -> NDArray[Any]:
        """Elements (count, width) to which `item` refers, as a view of the file's bytes.

        `item` is an accessor, or the `indices` or `values` of a sparse accessor.
        """
        data, stride = self.view(item["bufferView"])
        offset = self.integer(item, "byteOffset", what, 0)
        size = dtype.itemsize * width
        step = size if stride is None else stride
        check(step >= size, f"{what}: a stride of {step} bytes for elements of {size}")
        problem = f"{what}: {count} elements of {size} bytes do not fit in a view of {len(data)}"
        check(offset + step * (count - 1) + size <= len(data), problem)
        return np.ndarray((count, width), dtype, data, offset, (step, dtype.itemsize))
