"""The mesh that goes with a file of vertices alone (``.npy``, ``.pc2``, ``.mdd``, zarr)."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import check_faces
from ..errors import FormatError, InputError
from ..sequence import MeshSequence, Surface
from .arrays.archive import read_array
from .registry import reading

__all__ = ["Companion", "find"]

_SIBLINGS = (".obj", ".ply", ".off", ".npz")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Companion:
    """What a mesh adds to a file of vertices."""

    faces: NDArray[np.int32] | None = None
    surface: Surface | None = None
    vertex_map: NDArray[np.int32] | None = None
    fps: float | None = None

    def moved(self, vertices: Any, path: Path, fps: float | None) -> MeshSequence:
        """The mesh under the vertices (F, V, 3) that `path` holds."""
        with reading(path):
            return MeshSequence(
                vertices,
                self.faces,
                fps or self.fps or 24.0,
                name=path.stem,
                surface=self.surface,
                vertex_map=self.vertex_map,
            )


def find(path: Path, given: Any, argument: str, n_vertices: int) -> Companion:
    """Find and check the mesh of `path`.

    Parameters
    ----------
    path : Path
        The file of vertices.
    given : None, "none", path, (T, 3) int array or MeshSequence
        None looks for ``<stem>.faces.npy`` and for a mesh of the same stem
        beside `path`; "none" is a point cloud.
    argument : str
        What the caller calls `given`, for messages.
    n_vertices : int

    Raises
    ------
    InputError
        If nothing is found, or what was given does not fit.
    FormatError
        If the file found does not fit.
    """
    if isinstance(given, str) and given == "none":
        return Companion()
    if given is None:
        return _from_file(_sibling(path, argument), path, n_vertices)
    if isinstance(given, (str, os.PathLike)):
        return _from_file(Path(given), path, n_vertices)
    if isinstance(given, MeshSequence):
        if given.n_vertices != n_vertices:
            raise InputError(argument, f"a mesh of {n_vertices} vertices", given.n_vertices)
        return _of(given)
    return Companion(faces=check_faces(given, n_vertices, argument))


def _sibling(path: Path, argument: str) -> Path:
    for candidate in (path.with_suffix(".faces.npy"), *(path.with_suffix(s) for s in _SIBLINGS)):
        if candidate.is_file():
            return candidate
    raise InputError(
        argument,
        'a mesh, its path, an array of faces or "none" for a point cloud',
        f"nothing, and there is no mesh {path.stem}{_SIBLINGS[0]} beside {path}",
    )


def _from_file(mesh: Path, path: Path, n_vertices: int) -> Companion:
    from . import load

    if mesh.suffix.lower() == ".npy":
        try:
            return Companion(faces=check_faces(read_array(mesh), n_vertices))
        except InputError as error:
            raise FormatError(f"{mesh}: {error} (for {path})") from error
    sequence = load(mesh)
    if sequence.n_vertices != n_vertices:
        raise FormatError(f"{path}: {n_vertices} vertices, but {mesh} has {sequence.n_vertices}")
    return _of(sequence)


def _of(sequence: MeshSequence) -> Companion:
    return Companion(
        faces=sequence.faces,
        surface=sequence.surface,
        vertex_map=sequence.vertex_map,
        fps=sequence.fps,
    )
