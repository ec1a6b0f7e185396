"""Wavefront OBJ with the vertex order of the file, and its MTL materials.

trimesh splits vertices at seams of texture coordinates; here they stay whole
and the coordinates go to the corners.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ...sequence import Material, Surface
from ..atomic import write_bytes
from ..references import find_inside
from ..registry import describe, reading
from .polygons import Mesh, fan, vertex_rows

__all__ = ["ObjWriter", "parse_obj"]

_log = logging.getLogger(__name__)

_IMAGES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}
_SUFFIX = {"image/png": ".png", "image/jpeg": ".jpg"}


def parse_obj(path: Path, like: Mesh | None = None) -> Mesh:
    """Read one OBJ file.

    Parameters
    ----------
    path : Path
    like : Mesh, optional
        A file of the same sequence: where the text of the faces is the same,
        they are not parsed again, and the surface is not read.
    """
    with reading(path):
        data = path.read_bytes()
        if b"\0" in data:
            raise FormatError(f"{path}: not an OBJ file: {describe(data[:64])}")
        lines = [line.strip() for line in data.replace(b"\\\n", b" ").splitlines()]
        lines = [line.replace(b"\t", b" ") for line in lines if line and line[0] != 35]
        rows = [line.split()[1:] for line in lines if line.startswith(b"v ")]
        if not rows:
            raise FormatError(f"{path}: no vertices: {describe(data[:64])}")
        vertices = vertex_rows(rows)
        topology = b"\n".join(line for line in lines if line.startswith(b"f "))
        # Negative indices count from where they stand, so that equal text may differ in meaning.
        same = like is not None and topology == like.topology and b"-" not in topology
        if like is not None and same:
            return Mesh(vertices=vertices, faces=like.faces, topology=topology)
        faces, surface = _faces(path, lines, len(vertices), with_surface=like is None)
        return Mesh(vertices=vertices, faces=faces, surface=surface, topology=topology)


def _faces(
    path: Path, lines: list[bytes], n_vertices: int, *, with_surface: bool
) -> tuple[NDArray[np.int64], Surface | None]:
    seen = [0, 0, 0]
    corners: list[tuple[int, int, int]] = []
    counts: list[int] = []
    uv: list[list[bytes]] = []
    normals: list[list[bytes]] = []
    materials: list[str] = []
    libraries: list[str] = []
    used: list[int] = []
    current = -1
    for line in lines:
        if line.startswith(b"v "):
            seen[0] += 1
        elif line.startswith(b"f "):
            words = line.split()[1:]
            corners.extend(_corner(word, seen) for word in words)
            counts.append(len(words))
            used.append(current)
        elif line.startswith(b"vt "):
            seen[1] += 1
            uv.append([*line.split()[1:], b"0"][:2])
        elif line.startswith(b"vn "):
            seen[2] += 1
            normals.append(line.split()[1:])
        elif line.startswith(b"usemtl "):
            name = line[7:].strip().decode("utf-8", "replace")
            if name not in materials:
                materials.append(name)
            current = materials.index(name)
        elif line.startswith(b"mtllib "):
            libraries.append(line[7:].strip().decode("utf-8", "replace"))
    index = np.array(corners, dtype=np.int64).reshape(-1, 3)
    triangles, polygon = fan(np.array(counts, dtype=np.int64))
    for column, (what, count) in enumerate(
        (("vertex", n_vertices), ("texture coordinate", len(uv)), ("normal", len(normals)))
    ):
        highest = int(index[:, column].max(initial=-1))
        lowest = int(index[:, column].min(initial=0))
        if highest >= count or lowest < (0 if column == 0 else -1):
            wrong = highest if highest >= count else lowest
            raise FormatError(f"{path}: a face names {what} {wrong + 1}, there are {count}")
    faces = index[:, 0][triangles]
    if not with_surface:
        return faces, None
    surface = Surface(
        uv=_at_corners(path, np.array(uv, dtype=np.float32), index[:, 1][triangles], "uv"),
        normals=_at_corners(
            path, vertex_rows(normals).astype(np.float32), index[:, 2][triangles], "normals"
        ),
        material_index=np.maximum(np.array(used, dtype=np.int32), 0)[polygon]
        if len(materials) > 1
        else None,
        materials=_materials(path, libraries, materials),
    )
    bare = surface.uv is None and surface.normals is None and not surface.materials
    return faces, None if bare else surface


def _corner(word: bytes, seen: list[int]) -> tuple[int, int, int]:
    parts = [*word.split(b"/"), b"", b""][:3]
    out = []
    for part, count in zip(parts, seen, strict=True):
        number = int(part) if part else 0
        if part and number == 0:
            raise FormatError("a face names index 0; OBJ counts from 1")
        if number < -count:
            raise FormatError(f"a face names index {number} where {count} were defined")
        out.append(number - 1 if number >= 0 else count + number)
    return out[0], out[1], out[2]


def _at_corners(
    path: Path, table: NDArray[np.float32], index: NDArray[np.int64], what: str
) -> NDArray[np.float32] | None:
    if index.size == 0 or index.max() < 0:
        return None
    if not np.isfinite(table).all():
        raise FormatError(f"{path}: {what} are not finite")
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
        text = path.read_text(encoding="utf-8", errors="replace")
    materials: dict[str, dict[str, Any]] = {}
    current: dict[str, Any] = {}
    for line in text.splitlines():
        key, _, value = line.strip().partition(" ")
        value = value.strip()
        if key == "newmtl":
            current = materials.setdefault(value, {"name": value, "rgb": (0.8, 0.8, 0.8)})
        elif key == "map_Kd" and value:
            current["texture"], current["texture_type"] = _texture(path, value)
        elif key in ("Kd", "d", "Tr", "Pr", "Pm"):
            try:
                numbers = [min(1.0, max(0.0, float(word))) for word in value.split()]
            except ValueError as error:
                raise FormatError(f"{path}: not a number in {line.strip()[:60]!r}") from error
            if key == "Kd" and len(numbers) >= 3:
                current["rgb"] = tuple(numbers[:3])
            elif numbers and key != "Kd":
                current[key] = 1 - numbers[0] if key == "Tr" else numbers[0]
    return {
        name: Material(
            name=name,
            base_color=(*m["rgb"], m.get("d", m.get("Tr", 1.0))),
            metallic=m.get("Pm", 0.0),
            roughness=m.get("Pr", 0.9),
            texture=m.get("texture"),
            texture_type=m.get("texture_type", "image/png"),
        )
        for name, m in materials.items()
    }


def _texture(path: Path, value: str) -> tuple[bytes | None, str]:
    value = value.replace("\\", "/")
    # Options such as "-s 1 1 1" come before the name, which may hold spaces itself.
    file = find_inside(path, "texture", (value, value.split()[-1], Path(value).name))
    if file is not None:
        data = file.read_bytes()
        for magic, kind in _IMAGES.items():
            if data.startswith(magic):
                return data, kind
        _log.warning("%s: the texture %s is neither PNG nor JPEG; left out", path, file.name)
    return None, "image/png"


class ObjWriter:
    """Writes frames of one mesh; texts that all frames share are made once."""

    def __init__(
        self, faces: NDArray[np.int32], surface: Surface | None, folder: Path, stem: str
    ) -> None:
        self._faces = faces
        self._surface = surface or Surface()
        self._folder = folder
        self._stem = re.sub(r"[^A-Za-z0-9]+$", "", re.sub(r"\s+", "_", stem)) or "materials"
        self.bytes = 0
        self._head = b""
        if self._surface.materials:
            self._head = f"mtllib {self._stem}.mtl\n".encode()
            self._write_materials()
        columns = [faces.astype(np.int64) + 1, None, None]
        self._vt = b""
        if self._surface.uv is not None:
            table, index = np.unique(self._surface.uv.reshape(-1, 2), axis=0, return_inverse=True)
            self._vt = _rows("vt", table)
            columns[1] = index.reshape(-1, 3) + 1
        self._hard: NDArray[np.intp] | None = None
        if self._surface.normals is not None:
            # Corners of one vertex and one normal share a normal in every frame: hard edges stay.
            key = np.concatenate(
                [faces.reshape(-1, 1), self._surface.normals.reshape(-1, 3)], axis=1
            )
            _, first, index = np.unique(key, axis=0, return_index=True, return_inverse=True)
            self._hard = index.reshape(-1, 3)
            self._first = self._surface.normals.reshape(-1, 3)[first]
            columns[2] = self._hard + 1
        self._f = self._face_lines(columns)

    def write(self, path: Path, vertices: NDArray[Any], *, first: bool) -> None:
        """Write one frame; the first has the normals given, others the mean of their triangles."""
        parts = [self._head, _rows("v", vertices), self._vt]
        if self._hard is not None:
            parts.append(_rows("vn", self._first if first else self._normals(vertices)))
        self.bytes += write_bytes(path, b"".join([*parts, self._f]), flush=False)

    def _normals(self, vertices: NDArray[Any]) -> NDArray[np.float32]:
        assert self._hard is not None
        p = vertices[self._faces].astype(np.float64)
        area = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        total = np.zeros((len(self._first), 3))
        for corner in range(3):
            np.add.at(total, self._hard[:, corner], area)
        length = np.linalg.norm(total, axis=1, keepdims=True)
        return np.where(length > 0, total / np.where(length > 0, length, 1), self._first).astype(
            np.float32
        )

    def _face_lines(self, columns: list[Any]) -> bytes:
        vertex, uv, normal = columns
        if uv is None and normal is None:
            pattern, table = "f %d %d %d", vertex
        else:
            present = [c for c in columns if c is not None]
            table = np.stack(present, axis=2).reshape(len(vertex), -1)
            corner = "%d/%d/%d" if len(present) == 3 else "%d/%d" if normal is None else "%d//%d"
            pattern = f"f {corner} {corner} {corner}"
        lines = [pattern % tuple(row) for row in table.tolist()]
        materials = self._surface.materials
        if materials:
            index = self._surface.material_index
            last = -1
            marked = []
            for k, line in enumerate(lines):
                material = 0 if index is None else int(index[k])
                if material != last:
                    marked.append(f"usemtl {_word(materials[material].name)}")
                    last = material
                marked.append(line)
            lines = marked
        return ("\n".join(lines) + "\n").encode() if lines else b""

    def _write_materials(self) -> None:
        lines = []
        for k, m in enumerate(self._surface.materials):
            r, g, b, a = m.base_color
            lines += [f"newmtl {_word(m.name)}", f"Kd {r:.9g} {g:.9g} {b:.9g}", f"d {a:.9g}"]
            lines += [f"Pr {m.roughness:.9g}", f"Pm {m.metallic:.9g}"]
            if m.texture is not None:
                file = f"{self._stem}_texture_{k}{_SUFFIX.get(m.texture_type, '.png')}"
                lines.append(f"map_Kd {file}")
                self.bytes += write_bytes(self._folder / file, m.texture)
        text = "\n".join(lines) + "\n"
        self.bytes += write_bytes(self._folder / f"{self._stem}.mtl", text.encode())


def _word(name: str) -> str:
    return re.sub(r"\s+", "_", name.strip()) or "material"


def _rows(key: str, table: NDArray[Any]) -> bytes:
    number = "%.17g" if table.dtype == np.float64 else "%.9g"
    pattern = " ".join([key] + [number] * table.shape[1])
    return ("\n".join(pattern % tuple(row) for row in table.tolist()) + "\n").encode()
