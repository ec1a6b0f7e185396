"""Wavefront OBJ files, read in their order of vertices, and their MTL materials.

trimesh is not used here because it splits vertices at seams of texture coordinates. Here vertices
are not split, and the coordinates are stored at the corners of triangles.
"""

from __future__ import annotations

import array
import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ...normals import corner_normals
from ...surface import Material, Surface
from ..atomic import write_bytes
from ..references import find_inside
from ..registry import check, read_file, reading
from ..signatures import PICTURE_SUFFIXES, describe, picture_type
from .polygons import Mesh, fan, vertex_rows

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
        vertices = vertex_rows(rows)
        topology = b"\n".join(line for line in lines if line.startswith(b"f "))
        # Negative indices count back from their line, so equal text may name other vertices.
        if like is not None and topology == like.topology and b"-" not in topology:
            return Mesh(vertices=vertices, faces=like.faces, topology=topology)
        faces, surface = _faces(path, lines, with_surface=like is None)
        return Mesh(vertices=vertices, faces=faces, surface=surface, topology=topology)


def _faces(
    path: Path, lines: list[bytes], *, with_surface: bool
) -> tuple[NDArray[np.int64], Surface | None]:
    tables: dict[bytes, list[list[bytes]]] = {b"v": [], b"vt": [], b"vn": []}
    corners = array.array("q")  # a list for each would take five times the memory
    counts: list[int] = []
    materials: dict[str, int] = {}  # in the order in which they are named
    libraries: list[str] = []
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
        elif key == b"mtllib":
            libraries.append(rest.strip().decode("utf-8", "replace"))
    index = np.array(corners, dtype=np.int64).reshape(-1, 3)
    triangles, polygon = fan(np.array(counts, dtype=np.int64))
    for table, column, least in zip(tables, index.T, (0, -1, -1), strict=True):
        wrong = column[(column < least) | (column >= len(tables[table]))]
        if len(wrong):
            raise FormatError(
                f"a face names {table.decode()} {wrong[0] + 1}, there are {len(tables[table])}"
            )
    faces = index[:, 0][triangles]
    if not with_surface:
        return faces, None
    uv = np.array([[*row, b"0"][:2] for row in tables[b"vt"]], dtype=np.float32)
    normals = vertex_rows(tables[b"vn"]).astype(np.float32)
    surface = Surface(
        uv=_at_corners(path, uv, index[:, 1][triangles], "uv"),
        normals=_at_corners(path, normals, index[:, 2][triangles], "normals"),
        material_index=np.array(used, dtype=np.int32)[polygon] if len(materials) > 1 else None,
        materials=_materials(path, libraries, list(materials)),
    )
    bare = surface.uv is None and surface.normals is None and not surface.materials
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


def _materials(path: Path, libraries: list[str], names: list[str]) -> tuple[Material, ...]:
    known: dict[str, Material] = {}
    for library in libraries:
        spelled = [name.replace("\\", "/") for name in (library, *library.split())]
        file = find_inside(path, "material library", spelled)
        if file is not None:
            known.update(_parse_mtl(file))
    return tuple(known.get(name, Material(name=name)) for name in names)


def _parse_mtl(path: Path) -> dict[str, Material]:
    with reading(path):
        found: dict[str, dict[str, str]] = {}
        current: dict[str, str] = {}
        for line in read_file(path).decode("utf-8", "replace").splitlines():
            key, _, value = line.strip().partition(" ")
            if key == "newmtl":
                current = found.setdefault(value.strip(), {})
            else:
                current[key] = value.strip()
        return {name: _material(path, name, words) for name, words in found.items()}


def _material(path: Path, name: str, words: dict[str, str]) -> Material:
    def numbers(key: str, default: list[float]) -> list[float]:
        given = [min(1.0, max(0.0, float(word))) for word in words.get(key, "").split()]
        return given if len(given) >= len(default) else default

    opacity = numbers("d", [1 - numbers("Tr", [0.0])[0]])
    texture, kind = _texture(path, words["map_Kd"]) if words.get("map_Kd") else (None, "image/png")
    return Material(
        name=name,
        base_color=(*numbers("Kd", [0.8, 0.8, 0.8])[:3], opacity[0]),  # type: ignore[arg-type]
        metallic=numbers("Pm", [0.0])[0],
        roughness=numbers("Pr", [0.9])[0],
        texture=texture,
        texture_type=kind,
    )


def _texture(path: Path, value: str) -> tuple[bytes | None, str]:
    value = value.replace("\\", "/")
    # Options such as "-s 1 1 1" come before the name, which may hold spaces itself.
    file = find_inside(path, "texture", (value, value.split()[-1], Path(value).name))
    if file is not None:
        with reading(file):
            data = read_file(file)
        kind = picture_type(data)
        if kind is not None:
            return data, kind
        _log.warning("%s: the texture %s is neither PNG nor JPEG; left out", path, file.name)
    return None, "image/png"


class ObjWriter:
    """Writer of a mesh as one OBJ file per frame.

    Lines that are the same in all files (faces, texture coordinates, materials) are formatted only
    once.
    """

    def __init__(
        self, faces: NDArray[np.int32], surface: Surface | None, folder: Path, stem: str
    ) -> None:
        self._faces = faces
        self._surface = surface or Surface()
        stem = re.sub(r"[^A-Za-z0-9]+$", "", re.sub(r"\s+", "_", stem)) or "materials"
        self.bytes = 0
        self._head = self._vt = b""
        if self._surface.materials:
            self._head = f"mtllib {stem}.mtl\n".encode()
            self._write_materials(folder, stem)
        columns, corner = [faces.astype(np.int64) + 1], "%d"
        if self._surface.uv is not None:
            table, index = np.unique(self._surface.uv.reshape(-1, 2), axis=0, return_inverse=True)
            self._vt = _rows("vt", table)
            columns.append(index.reshape(-1, 3) + 1)
            corner += "/%d"
        if self._surface.normals is not None:
            # Corners of one vertex and one normal share a normal in every frame: hard edges stay.
            key = [faces.reshape(-1, 1), self._surface.normals.reshape(-1, 3)]
            _, self._first, index = np.unique(
                np.concatenate(key, axis=1), axis=0, return_index=True, return_inverse=True
            )
            columns.append(index.reshape(-1, 3) + 1)
            corner += "/%d" if self._vt else "//%d"
        rows = np.stack(columns, axis=2).reshape(len(faces), 3 * len(columns)).tolist()
        lines = [f"f {corner} {corner} {corner}" % tuple(row) for row in rows]
        if self._surface.materials:
            material = self._surface.material_index
            material = np.zeros(len(faces), dtype=np.int32) if material is None else material
            for k in np.flatnonzero(np.diff(material, prepend=-1)):
                name = _word(self._surface.materials[material[k]].name)
                lines[k] = f"usemtl {name}\n{lines[k]}"
        self._f = "".join(f"{line}\n" for line in lines).encode()

    def write(self, path: Path, vertices: NDArray[Any], *, first: bool) -> None:
        """Write one frame, with the normals of the surface if `first`, else of `vertices`."""
        parts = [self._head, _rows("v", vertices), self._vt]
        normals = self._surface.normals
        if normals is not None:
            if not first:
                normals = corner_normals(vertices, self._faces, self._surface)
            parts.append(_rows("vn", normals.reshape(-1, 3)[self._first]))
        self.bytes += write_bytes(path, b"".join([*parts, self._f]), flush=False)

    def _write_materials(self, folder: Path, stem: str) -> None:
        lines = []
        for k, m in enumerate(self._surface.materials):
            r, g, b, a = m.base_color
            lines += [f"newmtl {_word(m.name)}", f"Kd {r:.9g} {g:.9g} {b:.9g}", f"d {a:.9g}"]
            lines += [f"Pr {m.roughness:.9g}", f"Pm {m.metallic:.9g}"]
            if m.texture is not None:
                file = f"{stem}_texture_{k}{PICTURE_SUFFIXES.get(m.texture_type, '.png')}"
                lines.append(f"map_Kd {file}")
                self.bytes += write_bytes(folder / file, m.texture)
        text = "\n".join(lines) + "\n"
        self.bytes += write_bytes(folder / f"{stem}.mtl", text.encode())


def _word(name: str) -> str:
    return re.sub(r"\s+", "_", name.strip()) or "material"


def _rows(key: str, table: NDArray[Any]) -> bytes:
    number = "%.17g" if table.dtype == np.float64 else "%.9g"
    pattern = " ".join([key] + [number] * table.shape[1])
    return ("\n".join(pattern % tuple(row) for row in table.tolist()) + "\n").encode()
