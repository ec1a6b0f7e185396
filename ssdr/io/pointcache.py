"""Point caches ``.pc2`` and ``.mdd``: vertices over a mesh that another file holds.

PC2 (3ds Max, Blender): ``POINTCACHE2\\0``, then little-endian int32 version,
int32 points, float32 start, float32 rate (frames a sample), int32 samples, and
the samples as float32.  MDD (LightWave, Blender): big-endian int32 samples,
int32 points, the float32 time of every sample, then the samples as float32.
"""

from __future__ import annotations

import dataclasses
import logging
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, InputError
from ..sequence import MeshSequence
from .atomic import atomic_path
from .companion import over_mesh
from .registry import SaveReport, describe, reading, seconds, written_vertices

__all__ = ["read_mdd", "read_pc2", "write_mdd", "write_pc2"]

_log = logging.getLogger(__name__)

_PC2 = struct.Struct("<12siiffi")
_MDD = struct.Struct(">ii")


def read_pc2(
    path: Path, *, fps: float | None = None, mesh: Any = None, mmap: bool = False
) -> MeshSequence:
    """Read a PC2 cache.

    Parameters
    ----------
    path : Path
    fps : float, optional
        The mesh's, else 24, by default: the file says nothing.
    mesh : path, MeshSequence, (T, 3) int array or "none", optional
        What the cache deforms; the mesh of the same stem beside it by default,
        "none" for a point cloud.
    mmap : bool
        Map the file instead of reading it.

    Raises
    ------
    FormatError
        If the size of the file is not what its header states, or its number of
        points is not the mesh's.
    """
    with reading(path), path.open("rb") as stream:
        head = stream.read(_PC2.size)
        if len(head) < _PC2.size or not head.startswith(b"POINTCACHE2\0"):
            raise FormatError(f"{path}: not a PC2 cache: {describe(head)}")
        _, version, points, _, _, samples = _PC2.unpack(head)
        if version != 1:
            raise FormatError(f"{path}: PC2 of version {version}; 1 is known")
        vertices = _read(path, _PC2.size, samples, points, "<f4", mmap)
    return over_mesh(vertices, path, mesh, "mesh", fps)


def read_mdd(
    path: Path, *, fps: float | None = None, mesh: Any = None, mmap: bool = False
) -> MeshSequence:
    """Read an MDD cache; frames per second from its times unless given.

    Parameters and errors as for :func:`read_pc2`.
    """
    with reading(path), path.open("rb") as stream:
        head = stream.read(_MDD.size)
        if len(head) < _MDD.size:
            raise FormatError(f"{path}: not an MDD cache: {describe(head)}")
        samples, points = _MDD.unpack(head)
        vertices = _read(path, _MDD.size + 4 * samples, samples, points, ">f4", mmap)
        times = np.fromfile(stream, dtype=">f4", count=samples).astype(np.float64)
        fps = fps or _rate(path, times)
    return over_mesh(vertices, path, mesh, "mesh", fps)


def write_pc2(sequence: MeshSequence, path: Path, *, unweld: bool = False) -> SaveReport:
    """Write a PC2 cache.

    Parameters
    ----------
    sequence : MeshSequence
    path : Path
    unweld : bool
        Write the vertices of the mesh before it was welded (`vertex_map`), for
        playing on that mesh.

    Raises
    ------
    InputError
        If a coordinate is beyond the range of float32.
    """
    index, note = written_vertices(sequence, unweld)
    head = _PC2.pack(b"POINTCACHE2\0", 1, len(index), 0.0, 1.0, sequence.n_frames)
    return _write(sequence, path, head, "<f4", index, note)


def write_mdd(sequence: MeshSequence, path: Path, *, unweld: bool = False) -> SaveReport:
    """Write an MDD cache; its times carry the frames per second.

    Parameters and errors as for :func:`write_pc2`.
    """
    index, note = written_vertices(sequence, unweld)
    head = _MDD.pack(sequence.n_frames, len(index))
    times = seconds(np.arange(sequence.n_frames), sequence.fps).astype(">f4")
    return _write(sequence, path, head + times.tobytes(), ">f4", index, note)


def _read(path: Path, header: int, samples: int, points: int, kind: str, mmap: bool) -> Any:
    """Vertices (F, V, 3) behind the header, in a file of just that size."""
    if samples < 1 or points < 1:
        raise FormatError(f"{path}: states {samples} samples of {points} points")
    stated, held = header + 12 * samples * points, path.stat().st_size
    if held != stated:
        raise FormatError(
            f"{path}: states {samples} samples of {points} points, {stated} bytes, but holds {held}"
        )
    shape = (samples, points, 3)
    if mmap:
        return np.memmap(path, np.dtype(kind), "r", header, shape)
    flat = np.fromfile(path, dtype=kind, offset=header, count=3 * samples * points)
    return flat.reshape(shape).astype(np.float32, copy=False)


def _rate(path: Path, times: np.ndarray[Any, Any]) -> float | None:
    if len(times) < 2:
        return None
    span = float(times[-1] - times[0])
    steps = np.diff(times)
    if not np.isfinite(times).all() or not (steps > 0).all():
        raise FormatError(f"{path}: its times are not increasing numbers")
    mean = span / len(steps)
    if np.abs(steps - mean).max() > 0.01 * mean:
        _log.warning(
            "%s: the times of its samples are not even, %g to %g s apart; taken as even",
            path,
            steps.min(),
            steps.max(),
        )
    return round(1 / mean, 3) or 1 / mean  # the times are float32: 1/24 s comes back as 23.9999996


def _write(
    sequence: MeshSequence,
    path: Path,
    header: bytes,
    kind: str,
    index: NDArray[np.integer],
    note: str,
) -> SaveReport:
    total, worst = 0.0, 0.0
    with atomic_path(path) as temporary:
        with temporary.open("wb") as stream:
            stream.write(header)
            for start, block in sequence.chunks():
                with np.errstate(over="ignore"):
                    single = block.astype(np.float32)
                if not np.isfinite(single).all():
                    raise InputError(
                        "vertices",
                        "numbers within float32",
                        f"larger ones in frames {start} to {start + len(block) - 1}",
                    )
                squared = ((single.astype(np.float64) - block) ** 2).sum(axis=2)
                total, worst = total + float(squared.sum()), max(worst, float(squared.max()))
                stream.write(single[:, index].astype(kind, copy=False).tobytes())
        size = temporary.stat().st_size
    report = SaveReport(path=path, bytes=size, note=note)
    if sequence.vertices.dtype == np.float32:
        return report
    rmse = float(np.sqrt(total / (sequence.n_frames * sequence.n_vertices)))
    return dataclasses.replace(report, error=rmse, max_error=float(np.sqrt(worst)))
