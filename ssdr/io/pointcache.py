"""Point caches ``.pc2`` and ``.mdd``: positions of the vertices of a mesh in another file.

PC2 (3ds Max, Blender): ``POINTCACHE2\\0``, then little-endian int32 version, int32 number of
points, float32 start, float32 frames per sample, int32 number of samples, and the points of each
sample as float32. MDD (LightWave, Blender): big-endian int32 number of samples, int32 number of
points, the float32 time of each sample, then the points of each sample as float32.
"""

from __future__ import annotations

import dataclasses
import math
import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ..common.errors import SsdrWarning
from ..mesh.sequence import MeshSequence
from .arrays.npy import over_mesh
from .atomic import atomic_path
from .file_errors import check, reading
from .save_report import Rounding, SaveReport
from .signatures import describe

_PC2 = struct.Struct("<12siiffi")
_MDD = struct.Struct(">ii")


def read(
    path: Path, *, fps: float | None = None, faces: Any = None, mmap: bool = False
) -> MeshSequence:
    """Read a point cache as the motion of a mesh in another file.

    Parameters
    ----------
    path : Path
    fps : float, optional
        Samples per second. By default those that the times in an MDD cache imply. A PC2 cache has
        no times, only frames per sample; for it the default is the rate of the mesh, or 24 if the
        mesh states none, divided by the frames per sample.
    faces : path, MeshSequence, (T, 3) int array or "none", optional
        Mesh that the cache deforms, or its faces; by default the mesh file of the same stem in the
        same folder. "none" makes a point cloud.
    mmap : bool
        Map the file into memory instead of reading it.

    Raises
    ------
    FormatError
        If the size of the file is not what its header states, or its number of
        points is not the mesh's.
    """
    layout = _PC2 if path.suffix.lower() == ".pc2" else _MDD
    with reading(path), path.open("rb") as stream:
        head = stream.read(layout.size)
        step, known = 1.0, layout is _MDD or head.startswith(b"POINTCACHE2\0")
        check(known and len(head) == layout.size, f"not such a cache: {describe(head)}")
        if layout is _PC2:
            _, version, points, _, step, samples = layout.unpack(head)
            step = step if 0 < step < math.inf else 1.0
            start, kind = layout.size, "<f4"
            check(version == 1, f"PC2 of version {version}; 1 is known")
        else:
            samples, points = layout.unpack(head)
            start, kind = layout.size + 4 * samples, ">f4"
        stated, held = start + 12 * samples * points, path.stat().st_size
        count = f"{samples} samples of {points} points, {stated} bytes"
        whole = samples > 0 and points > 0 and held == stated
        check(whole, f"states {count}, but holds {held}")
        if layout is _MDD:
            fps = fps or _rate(path, np.fromfile(stream, dtype=kind, count=samples))
        shape = (samples, points, 3)
        if mmap:
            vertices: Any = np.memmap(path, np.dtype(kind), "r", start, shape)
        else:
            flat = np.fromfile(path, dtype=kind, offset=start)
            vertices = flat.reshape(shape).astype(np.float32, copy=False)
    sequence = over_mesh(vertices, path, faces, fps)
    if fps or step == 1:
        return sequence
    return dataclasses.replace(sequence, fps=sequence.fps / step, validate=False)


def write_sequence(sequence: MeshSequence, path: Path) -> SaveReport:
    """Write a point cache; an MDD file also holds the time of every frame.

    Raises
    ------
    InputError
        If a coordinate is beyond the range of float32.
    """
    count, points, before = sequence.n_frames, sequence.n_vertices, sequence.vertex_map
    notes: tuple[str, ...] = ()
    if before is not None:
        notes = (f"holds the {points} welded vertices, not the {len(before)} before",)
    if path.suffix.lower() == ".pc2":
        header, kind = _PC2.pack(b"POINTCACHE2\0", 1, points, 0.0, 1.0, count), "<f4"
    else:
        header, kind = _MDD.pack(count, points), ">f4"
        header += (np.arange(count) / sequence.fps).astype(kind).tobytes()
    error = Rounding()
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(header)
        for start, block in sequence.chunks():
            stored = error.round(block, start)
            stream.write(stored.astype(kind, copy=False).tobytes())
    return error.report(path, notes=notes)


def _rate(path: Path, times: np.ndarray[Any, Any]) -> float | None:
    """Frames per second from the times in an MDD cache, or None if there are fewer than two."""
    if len(times) < 2:
        return None
    steps = np.diff(times.astype(np.float64))
    increasing = np.isfinite(times).all() and (steps > 0).all()
    check(increasing, "its times are not increasing numbers")
    mean, least, most = float(steps.mean()), float(steps.min()), float(steps.max())
    if max(mean - least, most - mean) > 0.01 * mean:
        off = np.abs(times - times[0] - mean * np.arange(len(times))).max()
        warnings.warn(
            f"{path}: uneven times, {least:g} to {most:g} s apart, are taken as even: "
            f"frames play up to {off:.2g} s from their times",
            SsdrWarning,
            stacklevel=3,
        )
    return round(1 / mean, 3) or 1 / mean  # the times are float32, in which 1/24 s gives 23.9999996
