"""PLY, ASCII and binary of both byte orders, polygons of any size.

trimesh reads PLY too, but loses faces of mixed sizes in binary files, reorders
polygons and takes numbers that are cut off.
"""

from __future__ import annotations

import dataclasses
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ...sequence import Surface
from ..atomic import atomic_path
from ..registry import describe, reading
from .polygons import Mesh, fan

__all__ = ["parse_ply", "write_ply"]

_TYPES = {
    "char": "b",
    "int8": "b",
    "uchar": "B",
    "uint8": "B",
    "short": "h",
    "int16": "h",
    "ushort": "H",
    "uint16": "H",
    "int": "i",
    "int32": "i",
    "uint": "I",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float": "f",
    "float32": "f",
    "double": "d",
    "float64": "d",
}
_MAX_HEADER = 1 << 16  # bytes searched for end_header, so that no large file is searched whole
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


@dataclasses.dataclass(frozen=True)
class _Property:
    name: str
    kind: str
    count_kind: str | None = None


@dataclasses.dataclass(frozen=True)
class _Element:
    name: str
    length: int
    properties: list[_Property]


@dataclasses.dataclass(frozen=True, eq=False)
class _Lists:
    counts: NDArray[np.int64]
    values: NDArray[Any]


_Columns = dict[str, Any]


def parse_ply(path: Path, _like: Mesh | None = None) -> Mesh:
    """Read one PLY file; normals and texture coordinates of vertices go to the corners."""
    with reading(path):
        data = path.read_bytes()
        order, elements, offset = _header(path, data)
        if order == "ascii":
            tables = _ascii(elements, data[offset:].split())
        else:
            tables = _binary(elements, memoryview(data)[offset:], order)
        if "vertex" not in tables or not {"x", "y", "z"} <= set(tables["vertex"]):
            raise FormatError(f"{path}: no vertices with x, y, z")
        vertex = tables["vertex"]
        vertices = np.stack([vertex[c] for c in "xyz"], axis=1)
        face = tables.get("face", {})
        lists = face.get("vertex_indices", face.get("vertex_index"))
        if lists is None:
            return Mesh(vertices=vertices, faces=np.zeros((0, 3), dtype=np.int64))
        if not isinstance(lists, _Lists) or lists.values.dtype.kind not in "iu":
            raise FormatError(f"{path}: the faces are not lists of integers")
        corners, _ = fan(lists.counts)
        faces = lists.values.astype(np.int64)[corners]
        if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise FormatError(
                f"{path}: faces name the vertices {faces.min()} to {faces.max()}, "
                f"there are {len(vertices)}"
            )
        return Mesh(vertices=vertices, faces=faces, surface=_surface(vertex, faces))


def write_ply(path: Path, vertices: NDArray[Any], faces: NDArray[np.int32]) -> int:
    """Write one binary little-endian PLY file, float or double as given; its size."""
    kind, name = ("<f8", "double") if vertices.dtype == np.float64 else ("<f4", "float")
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            f"element vertex {len(vertices)}",
            *(f"property {name} {c}" for c in "xyz"),
            f"element face {len(faces)}",
            "property list uchar int vertex_indices",
            "end_header\n",
        ]
    )
    rows = np.empty(len(faces), dtype=[("n", "u1"), ("v", "<i4", (3,))])
    rows["n"], rows["v"] = 3, faces
    with atomic_path(path, flush=False) as temporary:
        with temporary.open("wb") as stream:
            stream.write(header.encode("ascii"))
            stream.write(np.ascontiguousarray(vertices, dtype=kind).tobytes())
            stream.write(rows.tobytes())
        return temporary.stat().st_size


def _header(path: Path, data: bytes) -> tuple[str, list[_Element], int]:
    if not data.startswith((b"ply\n", b"ply\r")):
        raise FormatError(f"{path}: not a PLY file: {describe(data[:64])}")
    end = data.find(b"end_header", 0, _MAX_HEADER)
    newline = data.find(b"\n", end, end + 16)
    if end < 0 or newline < 0:
        raise FormatError(f"{path}: its header does not end")
    order = ""
    elements: list[_Element] = []
    for line in data[:end].decode("ascii", errors="replace").splitlines()[1:]:
        words = line.split()
        match words:
            case ["format", "ascii", _]:
                order = "ascii"
            case ["format", "binary_little_endian", _]:
                order = "<"
            case ["format", "binary_big_endian", _]:
                order = ">"
            case ["element", name, length] if length.isdigit():
                elements.append(_Element(name, int(length), []))
            case ["property", "list", count, kind, name] if (
                elements and kind in _TYPES and _TYPES.get(count, "f") not in "fd"
            ):
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[count]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind]))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise FormatError(f"{path}: unknown line in its header: {line[:60]!r}")
    if not order:
        raise FormatError(f"{path}: its header names no format")
    names = [e.name for e in elements]
    if len(set(names)) != len(names):
        raise FormatError(f"{path}: two elements of one name")
    return order, elements, newline + 1


def _binary(elements: list[_Element], data: memoryview, order: str) -> dict[str, _Columns]:
    tables: dict[str, _Columns] = {}
    for element in elements:
        least = sum(struct.calcsize(p.count_kind or p.kind) for p in element.properties)
        if element.length * max(1, least) > len(data):
            raise FormatError(
                f"{element.length} of {element.name} need {element.length * least} bytes or more, "
                f"{len(data)} are left"
            )
        if element.length == 0:
            continue
        columns, used = _even(element, data, order) or _uneven(element, data, order)
        tables[element.name] = columns
        data = data[used:]
    if len(data):
        raise FormatError(f"{len(data)} bytes after the last element")
    return tables


def _even(element: _Element, data: memoryview, order: str) -> tuple[_Columns, int] | None:
    """All rows have lists as long as those of the first row, or None."""
    fields: list[Any] = []
    offset = 0
    for k, p in enumerate(element.properties):
        n = 1
        if p.count_kind is not None:
            n = struct.unpack_from(order + p.count_kind, data, offset)[0]
            if n < 0:
                return None
            fields.append((f"n{k}", order + p.count_kind))
            offset += struct.calcsize(p.count_kind)
            fields.append((f"p{k}", order + p.kind, (n,)))
        else:
            fields.append((f"p{k}", order + p.kind))
        offset += n * struct.calcsize(p.kind)
        if offset > len(data):
            return None
    if offset * element.length > len(data):
        return None
    rows = np.frombuffer(data, dtype=fields, count=element.length)
    columns: _Columns = {}
    for k, p in enumerate(element.properties):
        values = rows[f"p{k}"]
        values = values.astype(values.dtype.newbyteorder("="))
        if p.count_kind is None:
            columns[p.name] = values
            continue
        counts = rows[f"n{k}"].astype(np.int64)
        if (counts != values.shape[1]).any():
            return None
        columns[p.name] = _Lists(counts, values.ravel())
    return columns, offset * element.length


def _uneven(element: _Element, data: memoryview, order: str) -> tuple[_Columns, int]:
    counts: dict[str, list[int]] = {p.name: [] for p in element.properties}
    values: dict[str, list[Any]] = {p.name: [] for p in element.properties}
    offset = 0
    for _ in range(element.length):
        for p in element.properties:
            n = 1
            if p.count_kind is not None:
                n = struct.unpack_from(order + p.count_kind, data, offset)[0]
                offset += struct.calcsize(p.count_kind)
            size = n * struct.calcsize(p.kind)
            if n < 0 or offset + size > len(data):
                raise FormatError(f"a list in {element.name} is longer than the file")
            values[p.name].extend(struct.unpack_from(f"{order}{n}{p.kind}", data, offset))
            counts[p.name].append(n)
            offset += size
    columns: _Columns = {}
    for p in element.properties:
        array = np.array(values[p.name], dtype=p.kind)
        columns[p.name] = (
            array if p.count_kind is None else _Lists(np.array(counts[p.name], np.int64), array)
        )
    return columns, offset


def _ascii(elements: list[_Element], words: list[bytes]) -> dict[str, _Columns]:
    tables: dict[str, _Columns] = {}
    start = 0
    for element in elements:
        if element.length * max(1, len(element.properties)) > len(words) - start:
            raise FormatError(f"{element.length} of {element.name} stated, the file ends before")
        if element.length == 0:
            continue
        columns: _Columns = {}
        if all(p.count_kind is None for p in element.properties):
            stop = start + element.length * len(element.properties)
            table = np.array(words[start:stop], dtype=np.float64).reshape(element.length, -1)
            for k, p in enumerate(element.properties):
                columns[p.name] = table[:, k]
        else:
            counts: dict[str, list[int]] = {p.name: [] for p in element.properties}
            values: dict[str, list[bytes]] = {p.name: [] for p in element.properties}
            stop = start
            for _ in range(element.length):
                for p in element.properties:
                    n = 1
                    if p.count_kind is not None:
                        n, stop = int(words[stop]), stop + 1
                    if n < 0 or stop + n > len(words):
                        raise FormatError(f"a list in {element.name} is longer than the file")
                    values[p.name].extend(words[stop : stop + n])
                    counts[p.name].append(n)
                    stop += n
            for p in element.properties:
                kind = np.float64 if p.kind in "fd" else np.int64
                array = np.array([kind(w) for w in values[p.name]], dtype=kind)
                columns[p.name] = (
                    array
                    if p.count_kind is None
                    else _Lists(np.array(counts[p.name], dtype=np.int64), array)
                )
        tables[element.name] = columns
        start = stop
    if start != len(words):
        raise FormatError(f"{len(words) - start} words after the last element")
    return tables


def _surface(vertex: _Columns, faces: NDArray[np.int64]) -> Surface | None:
    def at_corners(names: tuple[str, ...]) -> NDArray[np.float32] | None:
        columns = [vertex.get(n) for n in names]
        if any(not isinstance(c, np.ndarray) for c in columns):
            return None
        table = np.stack(columns, axis=1).astype(np.float32)  # type: ignore[arg-type]
        if not np.isfinite(table).all():
            raise FormatError(f"{', '.join(names)} are not finite")
        return np.asarray(table[faces])

    uv = next((t for t in map(at_corners, _UV_NAMES) if t is not None), None)
    normals = at_corners(("nx", "ny", "nz"))
    return None if uv is None and normals is None else Surface(uv=uv, normals=normals)
