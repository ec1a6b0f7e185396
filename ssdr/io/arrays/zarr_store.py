"""Chunked arrays in a folder (``.zarr``), read lazily by chunks of frames."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import FormatError, InputError
from ...sequence import MeshSequence
from ..atomic import free_name, naming, remove
from ..companion import find
from ..registry import SaveReport, reading, require

__all__ = ["read", "write_sequence"]

_CHUNK = 8 << 20  # bytes of a stored chunk: larger ones make reading single frames slower
_MAX_BYTES = 1 << 42  # 4 TiB: stores are read chunk by chunk, so only absurd shapes are refused


def read(
    path: Path, *, fps: float | None = None, faces: Any = None, max_bytes: int = _MAX_BYTES
) -> MeshSequence:
    """Open an array ``(F, V, 3)``, or a group of ``vertices`` and ``faces``.

    Parameters
    ----------
    path : Path
    fps : float, optional
        The attribute ``fps``, else 24, by default.
    faces
        As for ``.npy``; a group's own by default.
    max_bytes : int
        Largest size of all frames together; 4 TiB by default.  A store of a few
        bytes can state any shape, and every frame is looked at once.
    """
    zarr = require("zarr", "zarr", str(path))
    with reading(path):
        if not path.is_dir():
            raise FormatError(f"{path}: not a folder, as a zarr store is")
        node = zarr.open(path, mode="r")
        stated = node.attrs.get("fps")
        vertices = node
        if not hasattr(node, "shape"):
            if "vertices" not in node:
                raise FormatError(f"{path}: no array vertices; it holds {sorted(node.keys())}")
            vertices = node["vertices"]
            if faces is None and "faces" in node:
                faces = np.asarray(node["faces"][:])
        if len(vertices.shape) != 3 or vertices.shape[2] != 3:
            raise FormatError(f"{path}: expected the shape (F, V, 3), got {vertices.shape}")
        size = math.prod(vertices.shape) * vertices.dtype.itemsize
        if size > max_bytes:
            raise FormatError(f"{path}: states {size} bytes, max_bytes is {max_bytes}")
        if fps is None and stated is not None:
            fps = float(stated)
    mesh = find(path, faces, "faces", vertices.shape[1])
    return mesh.moved(vertices, path, fps)


def write_sequence(sequence: MeshSequence, path: Path) -> SaveReport:
    """Write a group of ``vertices`` (chunks of whole frames), ``faces`` and ``fps``; exact."""
    zarr = require("zarr", "zarr", str(path))
    if not path.parent.is_dir():
        raise InputError("path", "a folder in a folder that exists", str(path))
    if path.exists() and not (path / "zarr.json").is_file() and not (path / ".zgroup").is_file():
        raise InputError("path", "a zarr store or a new name", f"{path}, something else")
    temporary = free_name(path)
    try:
        with naming(path, temporary):
            group = zarr.create_group(store=temporary, attributes={"fps": sequence.fps})
            vertices = sequence.vertices
            row = sequence.n_vertices * 3 * vertices.dtype.itemsize
            step = min(sequence.n_frames, max(1, _CHUNK // row))
            array = group.create_array(
                "vertices",
                shape=vertices.shape,
                dtype=np.dtype(vertices.dtype),
                chunks=(step, *vertices.shape[1:]),
            )
            for start, block in sequence.chunks(step * row):
                array[start : start + len(block)] = block
            group.create_array("faces", data=sequence.faces)
            size = sum(f.stat().st_size for f in temporary.rglob("*") if f.is_file())
            if path.exists():
                # A folder that is not empty cannot be replaced in one step.
                old = free_name(path)
                os.replace(path, old)
                os.replace(temporary, path)
                remove(old)
            else:
                os.replace(temporary, path)
    except BaseException:
        remove(temporary)
        raise
    lost = sequence.surface is not None or sequence.vertex_map is not None
    return SaveReport(
        path=path, bytes=size, note="surface and vertex map are not kept" if lost else ""
    )
