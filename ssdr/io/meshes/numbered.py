"""Sequences of numbered OBJ or PLY files."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...common.errors import FormatError, InputError, SsdrWarning
from ...mesh.sequence import MeshSequence
from ..file_errors import check, reading
from ..frame_rates import Range, frames_in
from ..mesh_names import natural_key
from ..save_report import SaveReport
from .obj import obj_lines, parse_obj, write_obj
from .ply import parse_ply, write_ply
from .polygons import Mesh

_NUMBER = re.compile(r"(.*?)([0-9]+)([^0-9]*)")
_PRINTF = re.compile(r"%0?([0-9]{0,2})d")


def read(path: Path, *, frames: Range = None, fps: float | None = None) -> MeshSequence:
    """Read a mesh file, or a folder or pattern of numbered files with one frame each.

    Frames follow the natural order of the files' names (2 before 10). Polygons are cut into
    triangles. UVs, normals and names of materials are those of the first file.

    Parameters
    ----------
    path : Path
        A file, a folder, a glob (``frame_*.ply``) or a printf pattern (``frame_%04d.obj``).
    frames : (first, last), optional
        Numbers of the first and last file to read; all by default. Files without a number count
        from 0 on.
    fps : float, optional
        Frames per second; 24 by default, because such files state no rate.

    Raises
    ------
    FormatError
        If a file is damaged, or differs from the first in its number of
        vertices or in its faces.
    FileNotFoundError
        If no file matches `path`.
    """
    files = _files(path, frames)
    parse = _PARSERS[files[0].suffix.lower()]
    first = parse(files[0], None)
    read = [first.vertices]
    for file in files[1:]:
        mesh = parse(file, first)  # of two files with the same text, the faces are parsed once
        _compare(file, mesh, files[0], first)
        read.append(mesh.vertices)
    with reading(files[0] if len(files) == 1 else path):
        return MeshSequence(
            np.stack(read), first.faces, fps or 24.0, name=_name(path), surface=first.surface
        )


def write_sequence(sequence: MeshSequence, path: Path) -> SaveReport:
    """Write one OBJ or PLY file per frame, with vertices and faces without loss.

    OBJ keeps UVs, the normals of the first frame and the names of materials.

    Parameters
    ----------
    sequence : MeshSequence
    path : Path
        A pattern such as ``folder/frame_%04d.obj``, numbered from 0; the folder is made if it is
        missing. A sequence of one frame may have a plain name. Files of these names are
        overwritten. A warning is issued if other files match the pattern.

    Raises
    ------
    InputError
        If a sequence of several frames has a plain name, or a name has two numbers.
    """
    several = _PRINTF.findall(path.name)
    if len(several) > 1 or (not several and sequence.n_frames > 1):
        expected = "one number such as %04d in the name, for a file a frame"
        raise InputError("path", expected, path.name)
    if several:
        path.parent.mkdir(parents=True, exist_ok=True)
    notes: list[str] = []
    size, obj = 0, path.suffix.lower() == ".obj"
    written: set[str] = set()
    if obj:
        lines = obj_lines(sequence.faces, sequence.surface)
        if sequence.surface is not None and sequence.surface.materials:
            notes.append("of materials, only the names are kept")
    elif sequence.surface is not None:
        notes.append("PLY has no seams: texture coordinates, normals and materials are not kept")
    for k, block in sequence.chunks():
        for t, vertices in enumerate(block, k):
            name = _PRINTF.sub(lambda m, t=t: m.group() % t, path.name)  # type: ignore[misc]
            file = path.with_name(name)
            written.add(name)
            if obj:
                size += write_obj(file, vertices, lines[t > 0])
            else:
                size += write_ply(file, vertices, sequence.faces)
    older = sorted({file.name for file in _matching(path)} - written) if several else []
    if older:
        text = f"{path}: beside the new files lie {len(older)} older ones of such names"
        said = f"{text}, as {older[0]}, which readers take for frames"
        warnings.warn(said, SsdrWarning, stacklevel=2)
    return SaveReport(path=path, bytes=size, notes=tuple(notes))


def _matching(path: Path) -> list[Path]:
    """Files whose names a printf pattern gives for some number."""
    name = _PRINTF.sub(lambda m: f"[0-9]{{{int(m[1] or 1)},}}", re.escape(path.name))
    return [f for f in path.parent.glob("*") if re.fullmatch(name, f.name)]


def _files(path: Path, wanted: Range) -> list[Path]:
    if path.is_dir():
        found = [f for f in path.iterdir() if f.suffix.lower() in _PARSERS and f.name[0] != "."]
    elif path.exists():
        return [path]
    elif _PRINTF.search(path.name):
        found = _matching(path)
    else:
        found = list(path.parent.glob(path.name))
    found = sorted((f for f in found if not f.is_dir()), key=lambda f: natural_key(f.name))
    if not found:
        raise FileNotFoundError(f"{path}: no mesh files ({', '.join(_PARSERS)})")
    kinds = sorted({f.suffix.lower() for f in found})
    known = ", ".join(_PARSERS)
    problem = f"{path}: files of {', '.join(kinds)}; name one of {known} by a pattern"
    check(len(kinds) == 1 and kinds[0] in _PARSERS, problem)
    if wanted is not None:
        parts = [_NUMBER.fullmatch(f.stem) for f in found]
        numbers = [float(m[2]) if m else k for k, m in enumerate(parts)]
        found = [found[k] for k in frames_in(wanted, np.array(numbers, dtype=np.float64))]
    _report_gaps(path, found)
    return found


def _report_gaps(path: Path, files: list[Path]) -> None:
    """Warn if names differ in more than a number; otherwise, warn if frames are missing.

    Raises a FormatError if two files have the same number.
    """
    if len(files) < 2:
        return
    parts = [_NUMBER.fullmatch(f.stem) for f in files]
    if len({m and (m[1], m[3]) for m in parts}) > 1 or parts[0] is None:
        first, last = files[0].name, files[-1].name
        text = f"{path}: names differ in more than a number: {first}, {last}"
        warnings.warn(text, SsdrWarning, stacklevel=3)
        return
    numbers = [int(m[2]) for m in parts if m]
    steps = np.diff(numbers)
    k = int(steps.argmin())
    check(steps[k] > 0, f"{path}: {files[k].name} and {files[k + 1].name} have the same number")
    gaps = [str(numbers[k]) for k in np.flatnonzero(steps > steps.min())]
    if gaps:
        count = (numbers[-1] - numbers[0]) // int(steps.min()) + 1 - len(numbers)
        text = (
            f"{path}: {count} frames are missing, after {', '.join(gaps[:8])}: those after them "
            "are read as the next, and play too early"
        )
        warnings.warn(text, SsdrWarning, stacklevel=3)


def _name(path: Path) -> str:
    stem = re.sub(r"[^A-Za-z0-9]+$", "", _PRINTF.sub("", path.stem).rstrip("*?"))
    return path.name if path.is_dir() else stem or path.parent.name


def _compare(file: Path, mesh: Mesh, first_file: Path, first: Mesh) -> None:
    for what in ("vertices", "faces"):
        n, m = len(getattr(mesh, what)), len(getattr(first, what))
        check(n == m, f"{file}: {n} {what}, but {first_file.name} has {m}")
    other = np.flatnonzero((mesh.faces != first.faces).any(axis=1))
    if len(other):
        k = other[0]
        raise FormatError(
            f"{file}: triangle {k} is {tuple(mesh.faces[k].tolist())}, "
            f"in {first_file.name} it is {tuple(first.faces[k].tolist())}"
        )


_PARSERS: dict[str, Callable[[Path, Mesh | None], Mesh]] = {
    ".obj": parse_obj,
    ".ply": parse_ply,
}
