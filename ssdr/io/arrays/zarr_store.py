"""Arrays stored in chunks in a folder (``.zarr``), whose frames are read when they are needed."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from ...common.checks import check_faces
from ...common.errors import InputError
from ...mesh.sequence import MeshSequence
from ..atomic import free_name, naming, remove
from ..file_errors import afford, check, reading, refuse_bomb, refuse_device
from ..optional import require
from ..save_report import SaveReport
from .npy import over_mesh

_CHUNK = 8 << 20  # bytes of a stored chunk: larger ones make reading single frames slower
_METADATA = ("zarr.json", ".zarray", ".zattrs", ".zgroup", ".zmetadata")


def read(
    path: Path, *, fps: float | None = None, faces: Any = None, max_bytes: int | None = None
) -> MeshSequence:
    """Open a store that holds an array ``(F, V, 3)``, or a group of ``vertices`` and ``faces``.

    Parameters
    ----------
    path : Path
    fps : float, optional
        Frames per second. By default the store's attribute ``fps``, or those of the mesh in
        `faces`, or 24.
    faces
        As for ``.npy``; by default the ``faces`` of the group, if it has them.
    max_bytes : int, optional
        Largest size of a chunk in memory. By default it is 16 GiB, and arrays above 256 MiB that
        inflate more than 100-fold are refused, too.

    Raises
    ------
    FormatError
        If the store is damaged or hostile, a chunk is missing, or chunks are compressed by
        anything but zstd and Blosc.
    """
    zarr = require("zarr", str(path))
    with reading(path):
        check(path.is_dir(), "not a folder, as a zarr store is")
        for folder, folders, files in os.walk(path):
            for name in files:
                refuse_device(Path(folder, name))
            for name in folders:
                link = Path(folder, name)
                check(not link.is_symlink(), f"{link}: a link to a folder, not followed")
        node = zarr.open(path, mode="r")
        group = {"vertices": node} if hasattr(node, "shape") else node
        check("vertices" in group, f"no array vertices; it holds {sorted(group.keys())}")
        vertices = group["vertices"]
        points = len(vertices.shape) == 3 and vertices.shape[2] == 3
        check(points, f"expected the shape (F, V, 3), got {vertices.shape}")
        _check_chunks(vertices, path / vertices.path, max_bytes)
        if faces is None and "faces" in group:
            _check_chunks(group["faces"], path / "faces", max_bytes)
            faces = check_faces(group["faces"][:], vertices.shape[1], "faces")
        if fps is None and "fps" in node.attrs:
            fps = float(node.attrs["fps"])
    return over_mesh(vertices, path, faces, fps)


def _check_chunks(array: Any, folder: Path, max_bytes: int | None) -> None:
    """Raise a FormatError if chunks of an array are missing or take more memory than allowed.

    zarr reads a missing chunk as zeros, so a damaged store would give wrong positions, and a store
    without data could state any number of frames.
    """
    codecs = [type(codec).__name__.removesuffix("Codec") for codec in array.compressors]
    kind = "shards" if array.shards else f"chunks compressed by {' and '.join(codecs)}"
    problem = f"{folder}: holds {kind}; whole chunks by zstd or Blosc are read"
    check(not array.shards and codecs in ([], ["Zstd"], ["Blosc"]), problem)
    files = [f for f in folder.rglob("*") if f.is_file() and f.name not in _METADATA]
    problem = f"{folder}: holds {len(files)} of {array.nchunks} chunks of the shape {array.shape}"
    hint = "a store written with write_empty_chunks=True has them all"
    check(len(files) == array.nchunks, f"{problem} ({hint})")
    size = math.prod(array.chunks) * array.dtype.itemsize
    afford(size, "a chunk", folder, max_bytes)
    if array.dtype.kind != "f" or array.dtype.itemsize not in (4, 8):  # is converted as a whole
        afford(8 * math.prod(array.shape), f"the shape {array.shape}", folder, max_bytes)
    stored = inflated = 0
    for file in files:
        held = file.stat().st_size
        stored += held
        if codecs and held:
            data = np.memmap(file, np.uint8, "r")  # only the headers are read
            held = _zstd_size(data) if codecs == ["Zstd"] else _number(data, 4, 4)
        inflated += max(size, held)
    refuse_bomb(inflated, stored, "the array", folder, max_bytes)


def _number(data: Any, start: int, width: int) -> int:
    """Little-endian integer in the `width` bytes of `data` from `start` on."""
    return int.from_bytes(data[start : start + width].tobytes(), "little")


def _zstd_size(data: Any) -> int:
    """Decompressed size of zstd data (RFC 8878), from the headers of its frames and blocks."""
    size = at = 0
    while at < len(data):
        flags = _number(data, at + 4, 1)
        single = flags >> 5 & 1  # segment, without a window descriptor
        width = (single, 2, 4, 8)[flags >> 6]
        known = _number(data, at, 4) == 0xFD2FB528 and width
        check(known, "a chunk is no zstd frame that states its size")
        at += 6 - single + (0, 1, 2, 4)[flags & 3]
        size += _number(data, at, width) + 256 * (width == 2)
        at += width
        block = 0
        while not block & 1:  # a block whose lowest bit is set is the last
            check(at < len(data), "a chunk is truncated")
            block = _number(data, at, 3)
            at += 3 + (1 if block >> 1 & 3 == 1 else block >> 3)
        at += flags & 4  # a checksum of four bytes
    return size


def write_sequence(sequence: MeshSequence, path: Path) -> SaveReport:
    """Write a zarr store: ``vertices``, ``faces`` and the attribute ``fps``.

    Each chunk of ``vertices`` holds whole frames. Numbers keep their full precision.
    """
    zarr = require("zarr", str(path))
    if not path.parent.is_dir():
        raise InputError("path", "a folder in a folder that exists", str(path))
    if path.exists() and not any((path / name).is_file() for name in _METADATA):
        raise InputError("path", "a zarr store or a new name", f"{path}, something else")
    temporary = free_name(path)
    try:
        with naming(path, temporary):
            group = zarr.create_group(store=temporary, attributes={"fps": sequence.fps})
            shape, dtype = sequence.vertices.shape, np.dtype(sequence.vertices.dtype)
            row = sequence.n_vertices * 3 * dtype.itemsize
            step = min(sequence.n_frames, max(1, _CHUNK // row))
            whole = {"write_empty_chunks": True}
            array = group.create_array(
                "vertices", shape=shape, dtype=dtype, chunks=(step, *shape[1:]), config=whole
            )
            for start, block in sequence.chunks(step * row):
                array[start : start + len(block)] = block
            group.create_array("faces", data=sequence.faces, config=whole)
            size = sum(f.stat().st_size for f in temporary.rglob("*") if f.is_file())
            old = free_name(path)
            if path.exists():  # a folder that is not empty cannot be replaced in one step
                os.replace(path, old)
            os.replace(temporary, path)
            remove(old)
    except BaseException:
        remove(temporary)
        raise
    lost = sequence.surface is not None or sequence.vertex_map is not None
    notes = ("surface and vertex map are not kept",) if lost else ()
    return SaveReport(path=path, bytes=size, notes=notes)
