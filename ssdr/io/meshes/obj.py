"""Wavefront OBJ files, read in their order of vertices; of materials, only the names.

trimesh is not used here because it splits vertices at seams of texture coordinates. Here vertices
are not split, and the coordinates are stored at the corners of triangles.
"""

from __future__ import annotations

import array
import dataclasses
import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...common.errors import FormatError
from ...mesh.surface import Material, Surface
from ..atomic import write_bytes
from ..file_errors import check, read_file, reading
from ..signatures import describe
from .polygons import Mesh, cut, opaque

_log = logging.getLogger(__name__)


def parse_obj(path: Path, like: Mesh | None = None) -> Mesh:
    """Read one OBJ file.

    Parameters
    ----------
    path : Path
    like : Mesh, optional
        Another file of the same sequence. If given, no surface is read, and its faces are taken if
        the text of the faces is the same.
    """
    with reading(path):
        data = read_file(path)
        check(b"\0" not in data, f"not an OBJ file: {describe(data[:64])}")
        lines = [line.strip() for line in data.replace(b"\\\n", b" ").splitlines()]
        lines = [line.replace(b"\t", b" ") for line in lines if line and line[0] != 35]
        rows = [line.split()[1:] for line in lines if line.startswith(b"v ")]
        check(rows, f"no vertices: {describe(data[:64])}")
        vertices, colors = _vertex_rows(rows), None
        if like is None and all(len(row) in (6, 7) for row in rows):  # with or without alpha
            colors = opaque(np.array([row[3:] for row in rows], dtype=np.float32))
        topology = b"\n".join(line for line in lines if line.startswith(b"f "))
        # Negative indices count back from their line, so equal text may name other vertices.
        if like is not None and topology == like.topology and b"-" not in topology:
            return Mesh(vertices=vertices, faces=like.faces, topology=topology)
        first = vertices if like is None else like.vertices
        faces, surface = _faces(path, lines, first, with_surface=like is None)
        if colors is not None:
            check(np.isfinite(colors).all(), "colours are not finite")
            surface = dataclasses.replace(surface or Surface(), colors=colors[faces])
        return Mesh(vertices=vertices, faces=faces, surface=surface, topology=topology)


def _vertex_rows(rows: list[list[bytes]]) -> NDArray[np.float64]:
    """Coordinates ``(V, 3)`` from the words of each line; words after the third are ignored."""
    if any(len(row) < 3 for row in rows):
        short = next(k for k, row in enumerate(rows) if len(row) < 3)
        raise FormatError(f"vertex {short} has {len(rows[short])} coordinates")
    return np.array([row[:3] for row in rows], dtype=np.float64).reshape(-1, 3)


def _faces(
    path: Path, lines: list[bytes], first: NDArray[Any], *, with_surface: bool
) -> tuple[NDArray[np.int64], Surface | None]:
    tables: dict[bytes, list[list[bytes]]] = {b"v": [], b"vt": [], b"vn": []}
    corners = array.array("q")  # a list for each would take five times the memory
    counts: list[int] = []
    materials: dict[str, int] = {}  # in the order in which they are named
    used: list[int] = []
    material = 0
    for line in lines:
        key, _, rest = line.partition(b" ")
        if key in tables:
            tables[key].append(rest.split())
        elif key == b"f":
            words = rest.split()
            for word in words:
                corners.extend(_corner(word, tables))
            counts.append(len(words))
            used.append(material)
        elif key == b"usemtl":
            name = rest.strip().decode("utf-8", "replace")
            material = materials.setdefault(name, len(materials))
    index = np.array(corners, dtype=np.int64).reshape(-1, 3)
    for table, column, least in zip(tables, index.T, (0, -1, -1), strict=True):
        wrong = column[(column < least) | (column >= len(tables[table]))]
        if len(wrong):
            raise FormatError(
                f"a face names {table.decode()} {wrong[0] + 1}, there are {len(tables[table])}"
            )
    triangles, polygon = cut(np.array(counts, dtype=np.int64), index[:, 0], first)
    faces = index[:, 0][triangles]
    if not with_surface:
        return faces, None
    uv = np.array([[*row, b"0"][:2] for row in tables[b"vt"]], dtype=np.float32)
    normals = _vertex_rows(tables[b"vn"]).astype(np.float32)
    surface = Surface(
        uv=_at_corners(path, uv, index[:, 1][triangles], "uv"),
        normals=_at_corners(path, normals, index[:, 2][triangles], "normals"),
        material_index=np.array(used, dtype=np.int32)[polygon] if len(materials) > 1 else None,
        materials=tuple(Material(name=name) for name in materials),
    )
    bare = surface.uv is None and surface.normals is None and not materials
    return faces, None if bare else surface


def _corner(word: bytes, tables: dict[bytes, list[list[bytes]]]) -> list[int]:
    """Indices (from 0) of the vertex, UV and normal of a corner, -1 where one is missing."""
    corner = []
    parts = [*word.split(b"/"), b"", b""]
    for part, table in zip(parts, tables.values(), strict=False):
        number = int(part) if part else 0
        if (part and number == 0) or number < -len(table):
            raise FormatError(f"a face names index {number} where {len(table)} were defined")
        corner.append(number - 1 if number >= 0 else len(table) + number)
    return corner


def _at_corners(
    path: Path, table: NDArray[np.float32], index: NDArray[np.int64], what: str
) -> NDArray[np.float32] | None:
    if index.size == 0 or index.max() < 0:
        return None
    check(np.isfinite(table).all(), f"{what} are not finite")
    if index.min() < 0:
        _log.warning("%s: %d corners have no %s; they get 0", path, (index < 0).sum(), what)
    return np.asarray(np.where(index[..., None] >= 0, table[index], np.float32(0)))


def obj_lines(faces: NDArray[np.int32], surface: Surface | None) -> tuple[bytes, bytes]:
    """Lines after the vertices, of the first OBJ file of a sequence and of each further one.

    The normals of a surface belong to one frame, so that only the first file has them.
    """
    surface = surface or Surface()
    columns, corner, uv = [faces.astype(np.int64) + 1], "%d", b""
    if surface.uv is not None:
        table, index = np.unique(surface.uv.reshape(-1, 2), axis=0, return_inverse=True)
        uv = _rows("vt", table)
        columns.append(index.reshape(-1, 3) + 1)
        corner += "/%d"
    later = uv + _face_lines(columns, corner, surface)
    if surface.normals is None:
        return later, later
    table, index = np.unique(surface.normals.reshape(-1, 3), axis=0, return_inverse=True)
    columns.append(index.reshape(-1, 3) + 1)
    corner += "/%d" if uv else "//%d"
    return uv + _rows("vn", table) + _face_lines(columns, corner, surface), later


def _face_lines(columns: list[NDArray[np.int64]], corner: str, surface: Surface) -> bytes:
    rows = np.stack(columns, axis=2).reshape(len(columns[0]), 3 * len(columns)).tolist()
    lines = [f"f {corner} {corner} {corner}\n" % tuple(row) for row in rows]
    if surface.materials:
        index = surface.material_index
        index = np.zeros(len(lines), dtype=np.int32) if index is None else index
        for k in np.flatnonzero(np.diff(index, prepend=-1)):
            name = re.sub(r"\s+", "_", surface.materials[index[k]].name.strip()) or "material"
            lines[k] = f"usemtl {name}\n{lines[k]}"
    return "".join(lines).encode()


def write_obj(path: Path, vertices: NDArray[Any], lines: bytes) -> int:
    """Write one frame, with `lines` after its vertices, and return the file's size in bytes."""
    return write_bytes(path, _rows("v", vertices) + lines, flush=False)


def _rows(key: str, table: NDArray[Any]) -> bytes:
    number = "%.17g" if table.dtype == np.float64 else "%.9g"
    pattern = " ".join([key] + [number] * table.shape[1])
    return ("\n".join(pattern % tuple(row) for row in table.tolist()) + "\n").encode()
