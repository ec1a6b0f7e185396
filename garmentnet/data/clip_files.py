"""Files of one clip: an archive of compressed arrays, whose frames are read as they are used.

The archive is an ``.npz``.  Its member ``document`` is a JSON text, ``joints`` and ``classes`` are
whole, and ``vertices-0``, ``vertices-32`` and so on hold 32 frames each.  All but the text are
compressed by Blosc.  Every member has a checksum, so that damage is always found.

Vertices are float32, or integer multiples of a step of length.  The integers are stored as second
differences in time of differences between successive vertices; these are small and compress to
about an eighth of float32.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numcodecs import Blosc
from numpy.typing import NDArray

from ssdr.io.arrays.array_files import read_arrays, write_arrays
from ssdr.io.file_errors import reading

Split = Literal["train", "validation", "test"]
# Number of frames whose vertices are compressed together: about 1 s, 100 KiB for 2,000 vertices.
_TOGETHER = 32
_CODEC = Blosc(cname="zstd", clevel=5, shuffle=Blosc.BITSHUFFLE)
# Axes of differences: along the vertices, then twice in time.
_AXES = (2, 0, 0)


def write_clip(
    path: Path,
    document: Mapping[str, Any],
    vertices: NDArray[np.float32],
    step: float,
    **others: NDArray[Any],
) -> None:
    """Write a clip under a temporary name; the file is renamed when it is complete.

    Parameters
    ----------
    path : Path
    document : dict
        What is stated of the clip, plain JSON.
    vertices : (F, V, 3) array
    step : float
        Step, metres, to whose multiples coordinates are rounded; 0: they are stored as float32.
    **others : arrays
        ``joints`` and ``classes``.
    """
    arrays = dict(others)
    for start in range(0, len(vertices), _TOGETHER):
        part = vertices[start : start + _TOGETHER]
        arrays[f"vertices-{start}"] = encode_steps(part, step) if step > 0 else part
    stored = {k: _CODEC.encode(np.ascontiguousarray(x)) for k, x in arrays.items()}
    stored = {"document": json.dumps(document).encode(), **stored}
    members = {k: np.frombuffer(data, np.uint8) for k, data in stored.items()}
    write_arrays(path, members, compress=False)


def read_document(path: Path) -> bytes:
    """Text of the JSON document of a clip."""
    return read_arrays(path, required=("document",))["document"].tobytes()


def read_parts(path: Path, shapes: Mapping[str, tuple[int, ...]], kind: Any) -> dict[str, Any]:
    """Arrays of a clip by name, given their shapes and their common type.

    Raises
    ------
    FormatError
        If one is missing or damaged, or its size is another.
    """
    stored = read_arrays(path, required=tuple(shapes))
    with reading(path):
        return {
            key: np.frombuffer(_CODEC.decode(stored[key]), kind).reshape(shape).copy()
            for key, shape in shapes.items()
        }


def encode_steps(vertices: NDArray[np.floating], step: float) -> NDArray[np.uint32]:
    """Integer differences ``(F, 3, V)`` that encode vertices ``(F, V, 3)`` as multiples of `step`.

    Examples
    --------
    >>> v = np.linspace(0, 1, 240).reshape(40, 2, 3)
    >>> back = decode_steps(encode_steps(v, 1e-3), 1e-3)
    >>> bool(np.abs(back - v).max() < 0.51e-3)
    True
    """
    x = np.rint(np.swapaxes(np.asarray(vertices, np.float64), 1, 2) / step).astype(np.int32)
    for axis in _AXES:
        x = np.diff(x, axis=axis, prepend=np.int32(0))
    # The sign goes to the lowest bit, so that small numbers of either sign have high bits of 0.
    return np.asarray((x << 1) ^ (x >> 31)).view(np.uint32)


def decode_steps(stored: NDArray[np.uint32], step: float) -> NDArray[np.float32]:
    """Vertices ``(F, V, 3)`` that :func:`encode_steps` encoded."""
    x = (stored >> 1).astype(np.int32) ^ -(stored & 1).astype(np.int32)
    for axis in reversed(_AXES):
        x = np.cumsum(x, axis=axis, dtype=np.int32)
    return (np.swapaxes(x, 1, 2) * step).astype(np.float32)


class StoredFrames:
    """Vertices on disk, which are read, checked and possibly reflected when they are indexed.

    Parameters
    ----------
    path : Path
        Path of the clip.
    shape : tuple of int
        F, V, 3.
    step : float
        Step of the stored integers, metres; 0: float32 is stored.
    permutation : (V,) int32 or None
        Mirror image of each vertex, with which the clip is reflected in x; None: not reflected.
    """

    def __init__(
        self,
        path: Path,
        shape: tuple[int, int, int],
        step: float,
        permutation: NDArray[np.int32] | None,
    ) -> None:
        self._path, self._step, self._permutation = path, step, permutation
        self.shape: tuple[int, ...] = shape
        self.dtype, self.ndim = np.dtype(np.float32), 3

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: Any) -> NDArray[np.float32]:
        first, rest = (index[0], index[1:]) if isinstance(index, tuple) else (index, ())
        frames = np.asarray(np.arange(len(self))[first])
        block = self._frames(frames)
        if self._permutation is not None:
            block = block[..., self._permutation, :] * np.array([-1, 1, 1], dtype=np.float32)
        return block[(slice(None),) * frames.ndim + rest]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self[:], dtype=dtype)

    def _frames(self, frames: NDArray[np.int64]) -> NDArray[np.float32]:
        """Frames of the given numbers, from the members that hold them."""
        total, count, _ = self.shape
        starts, of = frames - frames % _TOGETHER, {}
        for start in np.unique(starts).tolist():
            long = min(_TOGETHER, total - start)
            of[start] = (long, 3, count) if self._step > 0 else (long, count, 3)
        shapes = {f"vertices-{start}": shape for start, shape in of.items()}
        parts = read_parts(self._path, shapes, np.uint32 if self._step > 0 else np.float32)
        out = np.empty((*frames.shape, count, 3), np.float32)
        for start, part in zip(of, parts.values(), strict=True):
            here = starts == start
            whole = decode_steps(part, self._step) if self._step > 0 else part
            out[here] = whole[frames[here] - start]
        return out
