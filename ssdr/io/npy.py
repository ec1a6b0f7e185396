"""Plain NumPy arrays (``.npy``) of vertices, in memory or memory-mapped."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError
from ..sequence import MeshSequence
from .archive import read_header, write_array
from .atomic import atomic_path
from .companion import find
from .registry import SaveReport, describe, reading

__all__ = ["read", "read_array", "write_sequence"]


def read(
    path: Path, *, fps: float | None = None, faces: Any = None, mmap: bool = False
) -> MeshSequence:
    """Read an array of shape (F, V, 3).

    Parameters
    ----------
    path : Path
    fps : float, optional
        24 by default: the file says nothing.
    faces : (T, 3) int array, path, MeshSequence or "none", optional
        A path is of a mesh, an ``.npz`` or a ``.npy`` of faces.  By default
        ``<stem>.faces.npy``, then ``<stem>.obj``, ``.ply``, ``.off`` or
        ``.npz`` beside the file; "none" is a point cloud.
    mmap : bool
        Map the file instead of reading it.
    """
    array = read_array(path, mmap=mmap)
    if array.ndim != 3 or array.shape[2] != 3:
        raise FormatError(f"{path}: expected an array of shape (F, V, 3), got {array.shape}")
    mesh = find(path, faces, "faces", array.shape[1])
    with reading(path):
        return MeshSequence(
            array,
            mesh.faces,
            fps or mesh.fps or 24.0,
            name=path.stem,
            surface=mesh.surface,
            vertex_map=mesh.vertex_map,
        )


def read_array(path: Path, *, mmap: bool = False) -> NDArray[Any]:
    """Read or map one array; its size must be what its header states."""
    with reading(path), path.open("rb") as stream:
        head = stream.read(6)
        if head != b"\x93NUMPY":
            raise FormatError(f"{path}: not a .npy array: {describe(head + stream.read(64))}")
        stream.seek(0)
        dtype, shape, fortran = read_header(stream)
        offset = stream.tell()
        held, stated = path.stat().st_size - offset, math.prod(shape) * dtype.itemsize
        if held != stated:
            raise FormatError(
                f"{path}: states the shape {shape} of {dtype}, {stated} bytes, but holds {held}"
            )
        if mmap:
            return np.memmap(path, dtype, "r", offset, shape, "F" if fortran else "C")
        flat = np.fromfile(stream, dtype=dtype, count=math.prod(shape))
        return np.ascontiguousarray(flat.reshape(shape, order="F" if fortran else "C"))


def write_sequence(sequence: MeshSequence, path: Path) -> SaveReport:
    """Write the vertices to `path` and the faces to ``<stem>.faces.npy``; exact."""
    size = 0
    beside = path.with_suffix(".faces.npy")
    for target, array in ((beside, sequence.faces), (path, sequence.vertices)):
        with atomic_path(target) as temporary:
            with temporary.open("wb") as stream:
                write_array(stream, array)
            size += temporary.stat().st_size
    lost = sequence.surface is not None or sequence.vertex_map is not None
    return SaveReport(
        path=path,
        bytes=size,
        note=f"faces are in {beside.name}; fps"
        + (", surface and vertex map are" if lost else " is")
        + " not kept",
    )
