"""Files that hold only vertices: plain NumPy arrays (``.npy``), and the mesh of any such file."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ...common.checks import check_faces
from ...common.errors import FormatError, InputError
from ...mesh.sequence import MeshSequence
from ..atomic import atomic_path
from ..file_errors import check, reading
from ..save_report import SaveReport
from .array_files import read_array, write_array

_SUFFIXES = (".obj", ".ply", ".npz")


def read(
    path: Path, *, fps: float | None = None, faces: Any = None, mmap: bool = False
) -> MeshSequence:
    """Read vertices from an array of shape (F, V, 3).

    Parameters
    ----------
    path : Path
    fps : float, optional
        Frames per second; by default those of the mesh in `faces`, or 24 if it states none.
    faces : (T, 3) int array, path, MeshSequence or "none", optional
        Faces, a mesh, or the path of a mesh file or of a ``.npy`` file of faces. By default the
        first existing of ``<stem>.faces.npy``, ``<stem>.obj``, ``.ply`` and ``.npz`` in the
        same folder. "none" makes a point cloud.
    mmap : bool
        Map the file into memory instead of reading it.
    """
    array = read_array(path, mmap=mmap)
    points = array.ndim == 3 and array.shape[2] == 3
    check(points, f"{path}: expected an array of shape (F, V, 3), got {array.shape}")
    return over_mesh(array, path, faces, fps)


def write_sequence(sequence: MeshSequence, path: Path) -> SaveReport:
    """Write the vertices to `path` and the faces to ``<stem>.faces.npy``, without loss."""
    size = 0
    beside = path.with_suffix(".faces.npy")
    for target, array in ((beside, sequence.faces), (path, sequence.vertices)):
        with atomic_path(target) as temporary:
            with temporary.open("wb") as stream:
                write_array(stream, array)
            size += temporary.stat().st_size
    lost = sequence.surface is not None or sequence.vertex_map is not None
    kept_not = "fps, surface and vertex map are" if lost else "fps is"
    notes = f"faces are in {beside.name}", f"{kept_not} not kept"
    return SaveReport(path=path, bytes=size, notes=notes)


def reads(given: Any) -> bool:
    """Whether `given` names a mesh that :func:`over_mesh` reads, or none."""
    known = ("", ".npy", *_SUFFIXES)
    is_path = isinstance(given, (str, os.PathLike))
    return not is_path or Path(given).suffix.lower() in known


def over_mesh(vertices: Any, path: Path, given: Any, fps: float | None) -> MeshSequence:
    """Sequence of a file's vertices, with faces and surface of the mesh that goes with the file.

    Parameters
    ----------
    vertices : (F, V, 3) array-like
    path : Path
        The file that holds the vertices.
    given : None, "none", path, (T, 3) int array or MeshSequence
        The mesh, its path, or its faces. None looks for ``<stem>.faces.npy`` and for a mesh of the
        same stem in the folder of `path`; "none" makes a point cloud.
    fps : float, optional
        Frames per second; those of the mesh by default.

    Raises
    ------
    InputError
        If no mesh is found, or `given` does not fit the vertices.
    FormatError
        If the mesh of a file does not fit the vertices, or the vertices are not valid for a
        sequence.
    """
    n_vertices = vertices.shape[1]
    if given is None:
        given = _beside(path)
    if isinstance(given, MeshSequence):
        mesh = given
    elif isinstance(given, (str, os.PathLike)) and given != "none":
        mesh = _read(Path(given), path, n_vertices)
    else:
        mesh = _still(None if isinstance(given, str) else given, n_vertices)
    if mesh.n_vertices != n_vertices:
        raise InputError("faces", f"a mesh of {n_vertices} vertices", mesh.n_vertices)
    with reading(path):
        return MeshSequence(
            vertices,
            mesh.faces,
            fps or mesh.fps,
            name=path.stem,
            surface=mesh.surface,
            vertex_map=mesh.vertex_map,
        )


def _beside(path: Path) -> Path:
    for suffix in (".faces.npy", *_SUFFIXES):
        if path.with_suffix(suffix).is_file():
            return path.with_suffix(suffix)
    raise InputError(
        "faces",
        'a mesh, its path, an array of faces or "none" for a point cloud',
        f"nothing, and there is no mesh {path.stem}{_SUFFIXES[0]} beside {path}",
    )


def _read(file: Path, path: Path, n_vertices: int) -> MeshSequence:
    if file.suffix.lower() == ".npy":
        try:
            return _still(read_array(file), n_vertices)
        except InputError as error:
            raise FormatError(f"{file}: {error} (for {path})") from error
    from ..meshes import numbered  # at first use, so that importing ssdr.io is quick
    from . import npz

    mesh = npz.read(file) if file.suffix.lower() == ".npz" else numbered.read(file)
    if mesh.n_vertices != n_vertices:
        raise FormatError(f"{path}: {n_vertices} vertices, but {file} has {mesh.n_vertices}")
    return mesh


def _still(faces: Any, n_vertices: int) -> MeshSequence:
    """Sequence of one frame with the given faces and all vertices at the origin."""
    checked = check_faces(faces, n_vertices, "faces")
    return MeshSequence(np.zeros((1, n_vertices, 3)), checked, validate=False)
