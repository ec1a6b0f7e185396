"""Sequences of numbered mesh files: OBJ, PLY, OFF, STL and glTF."""

from __future__ import annotations

import logging
import re
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...errors import FormatError, InputError
from ...sequence import MeshSequence
from ..registry import SaveReport, describe, reading
from .obj import ObjWriter, parse_obj
from .ply import parse_ply, write_ply
from .polygons import Mesh, fan, vertex_rows

__all__ = ["check_pattern", "read", "write_sequence"]

_log = logging.getLogger(__name__)

_PRINTF = re.compile(r"%0?([0-9]{0,2})d")


def read(path: Path, *, fps: float | None = None) -> MeshSequence:
    """Read one mesh, a folder of them or a pattern.

    Files come in the natural order of their names (2 before 10).  Polygons are
    cut into fans of triangles.  STL has no shared vertices: corners that
    coincide in every frame become one vertex and `vertex_map` (3T,) keeps which.
    Of glTF files, each a frame, UVs, materials and textures of the first are kept.

    Parameters
    ----------
    path : Path
        A file, a folder, a glob (``frame_*.ply``) or a printf pattern
        (``frame_%04d.obj``, ``mesh_*.glb``).
    fps : float, optional
        24 by default: such files say nothing.

    Raises
    ------
    FormatError
        If a file is damaged, or differs from the first in its number of
        vertices or in its faces.
    FileNotFoundError
        If nothing matches.
    """
    files = _files(path)
    parse = _PARSERS[files[0].suffix.lower()]
    first = parse(files[0], None)
    frames = [first.vertices]
    for file in files[1:]:
        mesh = parse(file, first)
        _compare(file, mesh, files[0], first)
        frames.append(mesh.vertices)
    with reading(files[0] if len(files) == 1 else path):
        sequence = MeshSequence(
            np.stack(frames), first.faces, fps or 24.0, name=_name(path), surface=first.surface
        )
    if files[0].suffix.lower() == ".stl":
        sequence, report = sequence.weld(0.0)
        _log.info(
            "%s: STL repeats every vertex; %d corners became %d vertices, the map is kept",
            path,
            report.before,
            report.after,
        )
    return sequence


def write_sequence(sequence: MeshSequence, path: Path, *, start: int = 0) -> SaveReport:
    """Write one OBJ or PLY file a frame; exact.

    Parameters
    ----------
    sequence : MeshSequence
    path : Path
        A pattern such as ``folder/frame_%04d.obj``, whose folder is made where
        it is missing; a plain name for a sequence of one frame.
    start : int
        Number of the first file.

    Raises
    ------
    InputError
        If a sequence of several frames gets a plain name.
    """
    names = check_pattern(path, sequence.n_frames)
    if start < 0:
        raise InputError("start", "a number >= 0", start)
    if names:
        path.parent.mkdir(parents=True, exist_ok=True)
    stem = _PRINTF.sub("", path.stem) if names else path.stem
    size, note = 0, ""
    writer = None
    if path.suffix.lower() == ".obj":
        writer = ObjWriter(sequence.faces, sequence.surface, path.parent, stem)
    elif sequence.surface is not None:
        note = "PLY has no seams: texture coordinates, normals and materials are not kept"
    for k, block in sequence.chunks():
        for t, vertices in enumerate(block, k):
            name = _PRINTF.sub(lambda m, t=t: m.group() % (start + t), path.name)  # type: ignore[misc]
            file = path.with_name(name)
            if writer is None:
                size += write_ply(file, vertices, sequence.faces)
            else:
                writer.write(file, vertices, first=t == 0)
    return SaveReport(path=path, bytes=size if writer is None else writer.bytes, note=note)


def check_pattern(path: Path, n_frames: int) -> list[str]:
    """The numbers in a name, of which there must be one for a sequence of several frames.

    Raises
    ------
    InputError
        If there is none, or more than one.
    """
    names = _PRINTF.findall(path.name)
    if len(names) > 1 or (not names and n_frames > 1):
        raise InputError(
            "path", f"one number such as %04d in the name, for {n_frames} files", path.name
        )
    return names


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        found = [f for f in path.iterdir() if f.suffix.lower() in _PARSERS and f.name[0] != "."]
    elif path.exists():
        return [path]
    elif _PRINTF.search(path.name):
        found = _numbered(path)
    else:
        found = list(path.parent.glob(path.name))
    found = [f for f in found if f.is_file()]
    if not found:
        raise FileNotFoundError(f"{path}: no mesh files ({', '.join(_PARSERS)})")
    kinds = sorted({f.suffix.lower() for f in found})
    if len(kinds) > 1 or kinds[0] not in _PARSERS:
        raise FormatError(
            f"{path}: files of {', '.join(kinds)}; name one of {', '.join(_PARSERS)} by a pattern"
        )
    found.sort(key=lambda f: _natural(f.name))
    _report_gaps(path, found)
    return found


def _numbered(path: Path) -> list[Path]:
    number = _PRINTF.search(path.name)
    assert number is not None
    head, tail = path.name[: number.start()], path.name[number.end() :]
    digits = f"[0-9]{{{int(number[1] or 1)},}}"
    pattern = re.compile(re.escape(head) + digits + re.escape(tail))
    folder = path.parent
    return [f for f in folder.iterdir() if pattern.fullmatch(f.name)] if folder.is_dir() else []


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(p), "") if p.isdecimal() else (-1, p) for p in re.split(r"([0-9]+)", name)]


def _report_gaps(path: Path, files: list[Path]) -> None:
    parts = [re.fullmatch(r"(.*?)([0-9]+)([^0-9]*)", f.stem) for f in files]
    frames = {(m[1], m[3]) for m in parts if m}
    if not all(parts) or len(frames) > 1:
        if len(files) > 1:
            _log.warning(
                "%s: names differ in more than a number (%s, %s); taken in natural order",
                path,
                files[0].name,
                files[-1].name,
            )
        return
    numbers = np.array([int(m[2]) for m in parts if m])
    steps = np.diff(numbers)
    if len(steps) == 0:
        return
    if steps.min() == 0:
        k = int(steps.argmin())
        raise FormatError(f"{path}: {files[k].name} and {files[k + 1].name} have the same number")
    stride = int(steps.min())
    gaps = np.flatnonzero(steps > stride)
    if len(gaps):
        _log.warning(
            "%s: frames are missing after %s; %d files taken as consecutive",
            path,
            ", ".join(str(numbers[k]) for k in gaps[:8]),
            len(files),
        )


def _name(path: Path) -> str:
    if path.is_dir():
        return path.name
    return (
        re.sub(r"[^A-Za-z0-9]+$", "", _PRINTF.sub("", path.stem).rstrip("*?")) or path.parent.name
    )


def _compare(file: Path, mesh: Mesh, first_file: Path, first: Mesh) -> None:
    n, m = len(mesh.vertices), len(first.vertices)
    if n != m:
        raise FormatError(f"{file}: {n} vertices, but {first_file.name} has {m}")
    if mesh.faces is first.faces:
        return
    if len(mesh.faces) != len(first.faces):
        raise FormatError(
            f"{file}: {len(mesh.faces)} triangles, but {first_file.name} has {len(first.faces)}"
        )
    other = (mesh.faces != first.faces).any(axis=1)
    if other.any():
        k = int(other.argmax())
        raise FormatError(
            f"{file}: triangle {k} is {tuple(mesh.faces[k].tolist())}, "
            f"in {first_file.name} it is {tuple(first.faces[k].tolist())}"
        )


def _parse_off(path: Path, _like: Mesh | None = None) -> Mesh:
    with reading(path):
        data = path.read_bytes()
        lines = [line.split(b"#", 1)[0].split() for line in data.splitlines()]
        lines = [line for line in lines if line]
        if not lines or not re.fullmatch(rb"(ST)?C?N?OFF", lines[0][0]):
            raise FormatError(f"{path}: not an OFF file: {describe(data[:64])}")
        if lines[0][1:2] == [b"BINARY"]:
            raise FormatError(f"{path}: binary OFF is not read")
        start = 1 if len(lines[0]) > 1 else 2
        counts = lines[0][1:] if start == 1 else lines[1]
        n_vertices, n_faces = int(counts[0]), int(counts[1])
        if min(n_vertices, n_faces) < 0 or n_vertices + n_faces != len(lines) - start:
            raise FormatError(
                f"{path}: states {n_vertices} vertices and {n_faces} faces, "
                f"but holds {len(lines) - start} lines"
            )
        vertices = vertex_rows(lines[start : start + n_vertices])
        rows = lines[start + n_vertices :]
        corners = np.array([int(row[0]) for row in rows], dtype=np.int64)
        if any(n < 0 or len(row) < n + 1 for n, row in zip(corners, rows, strict=True)):
            raise FormatError(f"{path}: a face has fewer corners than it states")
        flat = np.array(
            [int(w) for n, row in zip(corners.tolist(), rows, strict=True) for w in row[1 : n + 1]],
            dtype=np.int64,
        )
        triangles, _ = fan(corners)
        return Mesh(vertices=vertices, faces=flat[triangles].reshape(-1, 3))


def _parse_stl(path: Path, _like: Mesh | None = None) -> Mesh:
    with reading(path):
        data = path.read_bytes()
        count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else 0
        if count and len(data) == 84 + 50 * count:
            kind = np.dtype([("normal", "<f4", 3), ("v", "<f4", (3, 3)), ("attribute", "<u2")])
            vertices = np.frombuffer(data, dtype=kind, offset=84)["v"].reshape(-1, 3)
        elif data[:5].lower() == b"solid" and b"\0" not in data:
            rows = re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", data, re.IGNORECASE)
            facets = len(re.findall(rb"endfacet", data, re.IGNORECASE))
            if not facets or len(rows) != 3 * facets or b"endsolid" not in data.lower():
                raise FormatError(f"{path}: {len(rows)} vertices in {facets} facets, or no end")
            vertices = np.array(rows, dtype=np.float64)
        else:
            stated = f"states {count} triangles in {len(data)} bytes" if count else "no STL"
            raise FormatError(f"{path}: {stated}; {describe(data[:64])}")
        return Mesh(vertices=vertices, faces=np.arange(len(vertices)).reshape(-1, 3))


def _parse_gltf(path: Path, _like: Mesh | None = None) -> Mesh:
    from .. import gltf

    frame = gltf.read(path)
    if len(frame) > 1:
        raise FormatError(
            f"{path}: an animation of {len(frame)} frames, where each file is one frame"
        )
    return Mesh(vertices=frame.vertices[0], faces=frame.faces, surface=frame.surface)


_PARSERS: dict[str, Callable[[Path, Mesh | None], Mesh]] = {
    ".obj": parse_obj,
    ".ply": parse_ply,
    ".off": _parse_off,
    ".stl": _parse_stl,
    ".glb": _parse_gltf,
    ".gltf": _parse_gltf,
}
