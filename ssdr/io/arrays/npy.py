"""Plain NumPy arrays (``.npy``) of vertices, in memory or memory-mapped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...mesh.sequence import MeshSequence
from ..atomic import atomic_path
from ..companion import over_mesh
from ..file_errors import check
from ..save_report import SaveReport
from .array_files import read_array, write_array


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
