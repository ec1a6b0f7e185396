"""Mesh for a file that holds only vertices (``.npy``, ``.pc2``, ``.mdd``, zarr)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from ..common.checks import check_faces
from ..common.errors import FormatError, InputError
from ..mesh.sequence import MeshSequence
from .arrays.array_files import read_array
from .file_errors import reading

_SUFFIXES = (".obj", ".ply", ".npz")


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
    from .arrays import npz  # at first use, so that importing ssdr.io is quick
    from .meshes import numbered

    mesh = npz.read(file) if file.suffix.lower() == ".npz" else numbered.read(file)
    if mesh.n_vertices != n_vertices:
        raise FormatError(f"{path}: {n_vertices} vertices, but {file} has {mesh.n_vertices}")
    return mesh


def _still(faces: Any, n_vertices: int) -> MeshSequence:
    """Sequence of one frame with the given faces and all vertices at the origin."""
    checked = check_faces(faces, n_vertices, "faces")
    return MeshSequence(np.zeros((1, n_vertices, 3)), checked, validate=False)
