"""PLY, ASCII and binary of both byte orders, polygons of any size.

trimesh refuses binary files with polygons of different sizes (Blender writes
such), reorders polygons, and reads on where a number or a row is cut off.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ...sequence import Surface
from ..atomic import write_bytes
from ..registry import describe, read_file, reading
from .polygons import Mesh, fan

__all__ = ["parse_ply", "write_ply"]

_KINDS = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
    "int64": "i8",
    "uint64": "u8",
}
_MOST_HEADER = 1 << 16  # bytes searched for end_header, so that no large file is searched whole
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


@dataclasses.dataclass(frozen=True)
class _Property:
    """Column of an element: one number in every row or, with a type of `count`, a list."""

    name: str
    kind: np.dtype[Any]
    count: np.dtype[Any] | None = None


@dataclasses.dataclass(frozen=True)
class _Element:
    name: str
    length: int
    properties: list[_Property]


_Columns = dict[str, tuple[NDArray[np.int64], NDArray[Any]]]  # numbers in each row, all numbers


def parse_ply(path: Path, _like: Mesh | None = None) -> Mesh:
    """Read one PLY file; normals and texture coordinates of vertices go to the corners."""
    with reading(path):
        data = read_file(path)
        elements, ascii_, start = _header(data)
        body = memoryview(data)[start:]
        if ascii_:  # each word as a double, which is what _header says of it
            body = memoryview(np.array(data[start:].split(), dtype=np.float64).tobytes())
        tables: dict[str, _Columns] = {}
        for element in elements:
            if element.length and element.properties:
                tables[element.name], used = _even(element, body) or _uneven(element, body)
                body = body[used:]
        if len(body):
            raise FormatError(f"{len(body)} bytes after the last element")
        vertex, face = tables.get("vertex", {}), tables.get("face", {})
        if not {"x", "y", "z"} <= set(vertex):
            raise FormatError("no vertices with x, y, z")
        vertices = np.stack([vertex[axis][1] for axis in "xyz"], axis=1)
        faces = np.zeros((0, 3), dtype=np.int64)
        if face:
            counts, values = face.get("vertex_indices") or face["vertex_index"]
            indices = values.astype(np.int64)
            if (indices != values).any():
                raise FormatError("the faces are not lists of integers")
            faces = indices[fan(counts)[0]]
        if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise FormatError(
                f"faces name the vertices {faces.min()} to {faces.max()}, there are {len(vertices)}"
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
    points = np.ascontiguousarray(vertices, dtype=kind).tobytes()
    return write_bytes(path, header.encode() + points + rows.tobytes(), flush=False)


def _header(data: bytes) -> tuple[list[_Element], bool, int]:
    """Elements, whether the rest is ASCII, and where that begins."""
    if not data.startswith((b"ply\n", b"ply\r")):
        raise FormatError(f"not a PLY file: {describe(data[:64])}")
    end = data.find(b"end_header", 0, _MOST_HEADER)
    newline = data.find(b"\n", end, end + 16)
    if end < 0 or newline < 0:
        raise FormatError("its header does not end")
    order = ""
    elements: list[_Element] = []

    def kind(word: str) -> np.dtype[Any]:
        return np.dtype("<f8" if order == "ascii" else order + _KINDS[word])

    for line in data[:end].decode("ascii", errors="replace").splitlines()[1:]:
        match line.split():
            case ["format", ("ascii" | "binary_little_endian" | "binary_big_endian") as named, _]:
                order = {"ascii": "ascii", "binary_big_endian": ">"}.get(named, "<")
            case ["element", name, length] if length.isdigit():
                elements.append(_Element(name, int(length), []))
            case ["property", "list", count, word, name] if (
                elements and order and word in _KINDS and _KINDS.get(count, "f")[0] != "f"
            ):
                elements[-1].properties.append(_Property(name, kind(word), kind(count)))
            case ["property", word, name] if elements and order and word in _KINDS:
                elements[-1].properties.append(_Property(name, kind(word)))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise FormatError(f"unknown line in its header: {line[:60]!r}")
    names = [element.name for element in elements]
    if len(set(names)) != len(names):
        raise FormatError("two elements of one name")
    return elements, order == "ascii", newline + 1


def _even(element: _Element, body: memoryview) -> tuple[_Columns, int] | None:
    """Columns of an element whose rows are all laid out like the first, and its size; or None."""
    fields: list[Any] = []
    at = 0
    for p in element.properties:
        n = 1
        if p.count is not None:
            n = int(np.frombuffer(body, p.count, 1, at)[0])
            fields.append((f"{p.name} count", p.count))
            at += p.count.itemsize
        at += n * p.kind.itemsize
        if n < 0 or at * element.length > len(body):
            return None
        fields.append((p.name, p.kind, (n,)))
    rows = np.frombuffer(body, fields, element.length)
    columns: _Columns = {}
    for p in element.properties:
        values = rows[p.name]
        counts = np.full(element.length, values.shape[1], dtype=np.int64)
        if p.count is not None and (rows[f"{p.name} count"] != counts).any():
            return None
        columns[p.name] = counts, values.astype(p.kind.newbyteorder("=")).ravel()
    return columns, rows.nbytes


def _uneven(element: _Element, body: memoryview) -> tuple[_Columns, int]:
    """Columns of an element whose rows differ in their lists, and its size in bytes."""
    counts: dict[str, list[int]] = {p.name: [] for p in element.properties}
    starts: dict[str, list[int]] = {p.name: [] for p in element.properties}
    at = 0
    for _ in range(element.length):
        for p in element.properties:
            n = 1
            if p.count is not None:
                stated = np.frombuffer(body, p.count, 1, at)[0]
                n = int(stated)
                if n < 0 or n != stated:
                    raise FormatError(f"a list in {element.name} states a length of {stated}")
                at += p.count.itemsize
            counts[p.name].append(n)
            starts[p.name].append(at)
            at += n * p.kind.itemsize
            if at > len(body):
                raise FormatError(
                    f"{element.length} of {element.name} stated, the file ends before"
                )
    columns: _Columns = {}
    for p in element.properties:
        count = np.array(counts[p.name], dtype=np.int64)
        size = count * p.kind.itemsize
        first = np.repeat(np.array(starts[p.name]) - np.cumsum(size) + size, size)
        values = np.frombuffer(body, np.uint8)[first + np.arange(len(first))].view(p.kind)
        columns[p.name] = count, values.astype(p.kind.newbyteorder("="))
    return columns, at


def _surface(vertex: _Columns, faces: NDArray[np.int64]) -> Surface | None:
    def at_corners(names: tuple[str, ...]) -> NDArray[np.float32] | None:
        if not set(names) <= set(vertex):
            return None
        table = np.stack([vertex[name][1] for name in names], axis=1).astype(np.float32)
        if not np.isfinite(table).all():
            raise FormatError(f"{', '.join(names)} are not finite")
        return np.asarray(table[faces])

    uv = next((t for t in map(at_corners, _UV_NAMES) if t is not None), None)
    normals = at_corners(("nx", "ny", "nz"))
    return None if uv is None and normals is None else Surface(uv=uv, normals=normals)
