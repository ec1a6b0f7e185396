"""Point caches ``.pc2`` and ``.mdd``: vertices over a mesh that another file holds.

PC2 (3ds Max, Blender): ``POINTCACHE2\\0``, then little-endian int32 version,
int32 points, float32 start, float32 rate (frames a sample), int32 samples, and
the samples as float32.  MDD (LightWave, Blender): big-endian int32 samples,
int32 points, the float32 time of every sample, then the samples as float32.
"""

from __future__ import annotations

import logging
import struct
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FormatError, InputError
from ..sequence import MeshSequence
from .atomic import atomic_path
from .companion import find
from .registry import SaveReport, describe, reading, seconds

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
    vertices = _samples(path, _PC2.size, samples, points, "<f4", mmap)
    return _sequence(path, vertices, fps, mesh)


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
        _check_size(path, _MDD.size, samples, points, per_sample=4)
        times = np.frombuffer(stream.read(4 * samples), dtype=">f4").astype(np.float64)
    vertices = _samples(path, _MDD.size + 4 * samples, samples, points, ">f4", mmap)
    return _sequence(path, vertices, fps or _rate(path, times), mesh)


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
    points = _n_points(sequence, unweld)
    head = _PC2.pack(b"POINTCACHE2\0", 1, points, 0.0, 1.0, sequence.n_frames)
    return _write(sequence, path, head, "<f4", unweld)


def write_mdd(sequence: MeshSequence, path: Path, *, unweld: bool = False) -> SaveReport:
    """Write an MDD cache; its times carry the frames per second.

    Parameters and errors as for :func:`write_pc2`.
    """
    head = _MDD.pack(sequence.n_frames, _n_points(sequence, unweld))
    times = seconds(np.arange(sequence.n_frames), sequence.fps).astype(">f4")
    return _write(sequence, path, head + times.tobytes(), ">f4", unweld)


def _check_size(path: Path, header: int, samples: int, points: int, per_sample: int) -> None:
    if samples < 1 or points < 1:
        raise FormatError(f"{path}: states {samples} samples of {points} points")
    stated = header + samples * (12 * points + per_sample)
    held = path.stat().st_size
    if held != stated:
        raise FormatError(
            f"{path}: states {samples} samples of {points} points, {stated} bytes, but holds {held}"
        )


def _samples(path: Path, header: int, samples: int, points: int, kind: str, mmap: bool) -> Any:
    with reading(path):
        if kind == "<f4":
            _check_size(path, header, samples, points, per_sample=0)
        shape = (samples, points, 3)
        if mmap:
            return np.memmap(path, np.dtype(kind), "r", header, shape)
        flat = np.fromfile(path, dtype=kind, offset=header, count=samples * points * 3)
        return flat.reshape(shape).astype(np.float32, copy=False)


def _sequence(path: Path, vertices: Any, fps: float | None, mesh: Any) -> MeshSequence:
    over = find(path, mesh, "mesh", vertices.shape[1])
    with reading(path):
        return MeshSequence(
            vertices,
            over.faces,
            fps or over.fps or 24.0,
            name=path.stem,
            surface=over.surface,
            vertex_map=over.vertex_map,
        )


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


def _n_points(sequence: MeshSequence, unweld: bool) -> int:
    if not unweld:
        return sequence.n_vertices
    if sequence.vertex_map is None:
        raise InputError("unweld", "a sequence that was welded", "one without vertex_map")
    return len(sequence.vertex_map)


def _write(
    sequence: MeshSequence, path: Path, header: bytes, kind: str, unweld: bool
) -> SaveReport:
    total, worst = 0.0, 0.0
    exact = sequence.vertices.dtype == np.float32
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
                if not exact:
                    squared = ((single.astype(np.float64) - block) ** 2).sum(axis=2)
                    total += float(squared.sum())
                    worst = max(worst, float(squared.max()))
                if unweld:
                    single = np.asarray(sequence.unweld(single, axis=1))
                stream.write(single.astype(kind, copy=False).tobytes())
        size = temporary.stat().st_size
    count = sequence.n_frames * sequence.n_vertices
    note = (
        ""
        if unweld or sequence.vertex_map is None
        else (
            f"holds the {sequence.n_vertices} welded vertices; unweld=True writes the "
            f"{len(sequence.vertex_map)} of the mesh before"
        )
    )
    return SaveReport(
        path=path,
        bytes=size,
        error=None if exact else float(np.sqrt(total / count)),
        max_error=None if exact else float(np.sqrt(worst)),
        note=note,
    )
