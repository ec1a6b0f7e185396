"""Files of one clip: a zarr group of three arrays and its attributes, checked as they are read.

Every chunk has a checksum, and a missing chunk reads as a value that no clip may hold, so that
damage is always found.

Vertices are float32, or integer multiples of a step of length.  The integers are stored as second
differences in time, within a chunk, of differences between successive vertices; these are small
and compress to about an eighth of float32.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, Crc32cCodec

from ssdr.common.errors import FormatError
from ssdr.io.atomic import atomic_path
from ssdr.io.file_errors import reading

from .skeleton import check_finite

Split = Literal["train", "validation", "test"]
# Number of frames whose vertices are compressed together: about 1 s, 100 KiB for 2,000 vertices.
_CHUNK_FRAMES = 32
# Type of every array, and the value that a missing chunk reads as.
_ARRAYS: Mapping[str, tuple[str, float]] = {
    "vertices": ("float32", math.nan),
    "steps": ("uint32", 0xFFFFFFFF),
    "joints": ("float32", math.nan),
    "classes": ("int8", -1),
}


def write_clip(
    target: Path,
    arrays: Mapping[str, NDArray[Any]],
    metadata: Mapping[str, Any],
    step: float = 0.0,
) -> None:
    """Write a clip under a temporary name; the folder is renamed when it is complete.

    Parameters
    ----------
    target : Path
    arrays : dict
        ``vertices`` (F, V, 3), ``joints`` (F, J, 3, 4), ``classes`` (F,).
    metadata : dict
        The clip's attributes, plain JSON.
    step : float
        Step, metres, to whose multiples coordinates are rounded; 0: they are stored as float32.
    """
    frames = len(arrays["vertices"])
    stored = dict(arrays)
    if step > 0:
        stored["steps"] = encode_steps(stored.pop("vertices"), step)
    with atomic_path(target, flush=False) as temporary:
        group = zarr.create_group(store=str(temporary), attributes=dict(metadata) | {"step": step})
        for key, values in stored.items():
            chunk = min(frames, _CHUNK_FRAMES) if key in ("vertices", "steps") else frames
            array = group.create_array(
                key,
                shape=values.shape,
                dtype=values.dtype,
                chunks=(chunk, *values.shape[1:]),
                fill_value=_ARRAYS[key][1],
                # A chunk is one file with dots in its name, not a file in nested folders.
                chunk_key_encoding={"name": "default", "separator": "."},
                compressors=compressors(
                    values.itemsize, "bitshuffle" if key == "steps" else "shuffle"
                ),
            )
            array[:] = values


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
    x[:, :, 1:] = np.diff(x, axis=2)
    for start in range(0, len(x), _CHUNK_FRAMES):
        chunk = x[start : start + _CHUNK_FRAMES]
        chunk[1:] = np.diff(chunk, axis=0)
        chunk[2:] = np.diff(chunk[1:], axis=0)
    # The sign goes to the lowest bit, so that small numbers of either sign have high bits of 0.
    return np.ascontiguousarray((x << 1) ^ (x >> 31)).view(np.uint32)


def decode_steps(stored: NDArray[np.uint32], step: float) -> NDArray[np.float32]:
    """Vertices ``(F, V, 3)`` that :func:`encode_steps` encoded, all or those of whole chunks."""
    x = (stored >> 1).astype(np.int32) ^ -(stored & 1).astype(np.int32)
    for start in range(0, len(x), _CHUNK_FRAMES):
        chunk = x[start : start + _CHUNK_FRAMES]
        chunk[1:] = np.cumsum(chunk[1:], axis=0, dtype=np.int32)
        chunk[:] = np.cumsum(chunk, axis=0, dtype=np.int32)
    whole = np.cumsum(x, axis=2, dtype=np.int32)
    return (np.swapaxes(whole, 1, 2) * step).astype(np.float32)


def open_array(path: Path, name: str, shape: tuple[int, ...]) -> Any:
    """Array of a clip, not yet read from disk, after a check of its type and shape.

    Raises
    ------
    FormatError
        If the array is missing, or its type or shape is another.
    """
    with reading(path):
        array = zarr.open_array(str(path / name), mode="r")
        kind = _ARRAYS[name][0]
        if tuple(array.shape) != shape or str(array.dtype) != kind:
            raise FormatError(
                f"{name}: expected {kind} {shape}, got {array.dtype} {tuple(array.shape)}"
            )
        return array


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
        if step > 0:
            self._array = open_array(path, "steps", (shape[0], 3, shape[1]))
        else:
            self._array = open_array(path, "vertices", shape)
        self.shape: tuple[int, ...] = shape
        self.dtype = np.dtype(np.float32)
        self.ndim = 3

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: Any) -> NDArray[np.float32]:
        first, rest = (index[0], index[1:]) if isinstance(index, tuple) else (index, ())
        with reading(self._path):
            block = self._decoded(first) if self._step > 0 else np.asarray(self._array[first])
            one = isinstance(first, int)
            check_finite(block[None] if one else block, "vertices", first if one else 0)
        if self._permutation is not None:
            block = block[..., self._permutation, :] * np.array([-1, 1, 1], dtype=np.float32)
        if rest:
            block = block[(slice(None),) * (block.ndim - 2) + rest]
        return block

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self[:], dtype=dtype)

    def _decoded(self, index: Any) -> NDArray[np.float32]:
        """Frames selected by an index, decoded from the chunks that hold them."""
        frames = np.arange(len(self))[index]
        chunks, place = np.unique(frames // _CHUNK_FRAMES, return_inverse=True)
        out = np.empty((*np.shape(frames), *self.shape[1:]), np.float32)
        for k, c in enumerate(chunks):
            start = c * _CHUNK_FRAMES
            stored = np.asarray(self._array[start : start + _CHUNK_FRAMES])
            if (stored == _ARRAYS["steps"][1]).any():
                raise FormatError(f"vertices: a chunk is missing from frame {start} on")
            here = place.reshape(np.shape(frames)) == k
            out[here] = decode_steps(stored, self._step)[frames[here] - start]
        return out


def compressors(itemsize: int = 4, shuffle: Any = "shuffle") -> Sequence[Any]:
    """Codecs with which the arrays of a store are compressed; `itemsize` is in bytes."""
    # The checksum comes last: a flipped bit is found before anything is decompressed.
    return (
        BloscCodec(cname="zstd", clevel=5, shuffle=shuffle, typesize=itemsize),
        Crc32cCodec(),
    )
