"""PLY files: ASCII, and binary in both byte orders, with polygons of any size.

trimesh is not used here because it refuses binary files with polygons of different sizes (as
Blender writes), reorders polygons, and does not notice that a number or a row is cut off.
"""

from __future__ import annotations

import array
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import FormatError
from ...mesh.surface import Surface
from ..atomic import write_bytes
from ..file_errors import check, read_file, reading
from ..signatures import describe
from .polygons import Mesh, cut, opaque

_KINDS = {  # type codes of struct and NumPy
    **dict.fromkeys(("char", "int8"), "b"),
    **dict.fromkeys(("uchar", "uint8"), "B"),
    **dict.fromkeys(("short", "int16"), "h"),
    **dict.fromkeys(("ushort", "uint16"), "H"),
    **dict.fromkeys(("int", "int32"), "i"),
    **dict.fromkeys(("uint", "uint32"), "I"),
    **dict.fromkeys(("float", "float32"), "f"),
    **dict.fromkeys(("double", "float64"), "d"),
    "int64": "q",
    "uint64": "Q",
}
_MOST_HEADER = 1 << 16  # bytes searched for end_header, so that no large file is searched whole
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


# Name, type of the numbers, and type of a list's length (None if the property is no list).
_Property = tuple[str, str, str | None]
_Elements = dict[str, tuple[int, list[_Property]]]  # number of rows, and properties
_Columns = dict[str, tuple[NDArray[np.int64], NDArray[Any]]]  # counts by row, all numbers


def parse_ply(path: Path, like: Mesh | None = None) -> Mesh:
    """Read one PLY file; normals and UVs of its vertices are copied to the triangle corners."""
    with reading(path):
        data = read_file(path)
        elements, most, ascii_, start = _header(data)
        body = memoryview(data)[start:]
        if ascii_:  # words become doubles, the type that _header states for ASCII
            body = memoryview(np.array(data[start:].split(), dtype=np.float64).tobytes())
        tables: dict[str, _Columns] = {}
        for name, (length, properties) in elements.items():
            if length and properties:
                read = _even(length, properties, body) or _uneven(length, properties, body)
                tables[name], used = read
                body = body[used:]
        check(not len(body), f"{len(body)} bytes after the last element")
        vertex, face = tables.get("vertex", {}), tables.get("face", {})
        check({"x", "y", "z"} <= set(vertex), "no vertices with x, y, z")
        vertices = np.stack([vertex[axis][1] for axis in "xyz"], axis=1)
        faces = np.zeros((0, 3), dtype=np.int64)
        if face:
            counts, values = face.get("vertex_indices") or face["vertex_index"]
            with np.errstate(invalid="ignore"):  # of what is no integer at all
                indices = values.astype(np.int64)
            check((indices == values).all(), "the faces are not lists of integers")
            first = vertices if like is None else like.vertices
            faces = indices[cut(counts, indices, first)[0]]
        return Mesh(vertices=vertices, faces=faces, surface=_surface(vertex, faces, most))


def write_ply(path: Path, vertices: NDArray[Any], faces: NDArray[np.int32]) -> int:
    """Write a binary PLY file in the float type of `vertices`, and return its size in bytes."""
    kind, name = ("<f8", "double") if vertices.dtype == np.float64 else ("<f4", "float")
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        + "".join(f"property {name} {axis}\n" for axis in "xyz")
        + f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), dtype=[("n", "u1"), ("v", "<i4", (3,))])
    rows["n"], rows["v"] = 3, faces
    points = np.ascontiguousarray(vertices, dtype=kind).tobytes()
    return write_bytes(path, header.encode() + points + rows.tobytes(), flush=False)


def _header(data: bytes) -> tuple[_Elements, dict[str, int], bool, int]:
    """Elements of a file, whether its body is ASCII, and the offset of the body in bytes.

    The second is the largest number of each property of vertices that is an unsigned integer.
    """
    check(data.startswith((b"ply\n", b"ply\r")), f"not a PLY file: {describe(data[:64])}")
    end = data.find(b"end_header", 0, _MOST_HEADER)
    newline = data.find(b"\n", end, end + 16)
    check(end >= 0 and newline >= 0, "its header does not end")
    order = ""
    most: dict[str, int] = {}
    elements: _Elements = {}
    properties: list[_Property] = []

    def kind(word: str) -> str:
        return "<d" if order == "ascii" else order + _KINDS[word]

    for line in data[:end].decode("ascii", errors="replace").splitlines()[1:]:
        match line.split():
            case ["format", ("ascii" | "binary_little_endian" | "binary_big_endian") as named, _]:
                order = {"ascii": "ascii", "binary_big_endian": ">"}.get(named, "<")
            case ["element", name, length] if length.isdigit() and name not in elements:
                properties = []
                elements[name] = int(length), properties
            case ["property", "list", count, word, name] if (
                order and word in _KINDS and _KINDS.get(count, "f") not in "fd"
            ):
                properties.append((name, kind(word), kind(count)))
            case ["property", word, name] if order and word in _KINDS:
                properties.append((name, kind(word), None))
                if properties is elements.get("vertex", (0, None))[1] and _KINDS[word] in "BHI":
                    most[name] = np.iinfo(_KINDS[word]).max
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise FormatError(f"unknown line in its header: {line[:60]!r}")
    return elements, most, order == "ascii", newline + 1


def _even(
    length: int, properties: list[_Property], body: memoryview
) -> tuple[_Columns, int] | None:
    """Read an element whose rows all have the same layout; return its columns and size in bytes.

    Returns None if the lengths of lists differ or the file is too short.
    """
    fields: list[Any] = []
    at = 0
    for name, kind, count in properties:
        n = 1
        if count is not None:
            n = int(np.frombuffer(body, count, 1, at)[0])
            fields.append((f"{name} count", count))
            at += np.dtype(count).itemsize
        fields.append((name, kind, (n,)))
        at += n * np.dtype(kind).itemsize
        if n < 0 or at * length > len(body):
            return None
    rows = np.frombuffer(body, fields, length)
    counts = {name: np.full(length, rows[name].shape[1]) for name, _, _ in properties}
    lists = [name for name, _, count in properties if count is not None]
    if any((rows[f"{name} count"] != counts[name]).any() for name in lists):
        return None
    return {name: (counts[name], rows[name].ravel()) for name in counts}, rows.nbytes


def _uneven(length: int, properties: list[_Property], body: memoryview) -> tuple[_Columns, int]:
    """Read an element whose rows hold lists of any lengths; return its columns and size."""
    problem = f"states {length} rows, but the file ends before"
    least = sum(np.dtype(count or kind).itemsize for _, kind, count in properties)
    check(length * least <= len(body), problem)
    steps = [
        (array.array("q"), bytearray(), np.dtype(kind).itemsize, struct.Struct(count or ""))
        for _, kind, count in properties
    ]
    at = 0
    for _ in range(length):
        for counts, values, size, head in steps:
            n = 1
            if head.size:
                check(at + head.size <= len(body), problem)
                (n,) = head.unpack_from(body, at)
                check(0 <= n <= len(body) and n % 1 == 0, problem)
                at += head.size
            counts.append(int(n))
            values += body[at : at + int(n) * size]
            at += int(n) * size
        check(at <= len(body), problem)
    columns = {
        name: (np.array(counts), np.frombuffer(bytes(values), kind))
        for (name, kind, _), (counts, values, *_) in zip(properties, steps, strict=True)
    }
    return columns, at


def _surface(vertex: _Columns, faces: NDArray[np.int64], most: dict[str, int]) -> Surface | None:
    """UVs, normals and colours of vertices; unsigned integers are shares of the largest, `most`."""

    def at_corners(names: tuple[str, ...]) -> NDArray[np.float32] | None:
        if not set(names) <= set(vertex):
            return None
        columns = [vertex[name][1] / most.get(name, 1) for name in names]
        table = np.stack(columns, axis=1).astype(np.float32)
        check(np.isfinite(table).all(), f"{', '.join(names)} are not finite")
        return np.asarray(table[faces])

    uv = next((t for t in map(at_corners, _UV_NAMES) if t is not None), None)
    normals, rgb = at_corners(("nx", "ny", "nz")), ("red", "green", "blue")
    colors = next((c for c in map(at_corners, ((*rgb, "alpha"), rgb)) if c is not None), None)
    if uv is None and normals is None and colors is None:
        return None
    return Surface(uv=uv, normals=normals, colors=None if colors is None else opaque(colors))
