"""Errors of writing that name the file, and arrays on disk that are checked as they are opened."""

from __future__ import annotations

import contextlib
import functools
import os
import shutil
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssdr.errors import FormatError, SsdrError
from ssdr.io.arrays.archive import read_array
from ssdr.io.atomic import write_bytes

__all__ = ["map_array", "write_file", "writing"]


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn what a full or protected disk raises inside the block into an error that names the file.

    Libraries raise different errors for it: safetensors has a class of its own.

    Raises
    ------
    SsdrError
        With the reason and the free space; other errors pass.
    """
    try:
        yield
    except SsdrError:
        raise
    except Exception as error:
        if not (isinstance(error, OSError) or "I/O error" in str(error)):
            raise
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise SsdrError(f"{path}: could not be written: {reason}{_free_space(path)}") from error


def write_file(path: Path, data: bytes) -> None:
    """Write a file, complete or not at all, with the errors of :func:`writing`."""
    with writing(path):
        write_bytes(path, data)


def map_array(path: Path, shape: tuple[int, ...], checksum: int | None) -> NDArray[np.float32]:
    """A float32 array in a ``.npy`` file, memory-mapped.

    Parameters
    ----------
    path : Path
    shape : tuple of int
        The shape that it must have.
    checksum : int or None
        CRC-32 of the file; None: unknown, not checked.

    Raises
    ------
    FormatError
        If the file is damaged or is another array.
    """
    status = path.stat()
    if checksum not in (None, _checksum(path, status.st_size, status.st_mtime_ns)):
        raise FormatError(f"{path}: damaged (its checksum differs); without it, it is made again")
    array: NDArray[Any] = read_array(path, mmap=True)
    if array.shape != shape or array.dtype != np.float32:
        raise FormatError(f"{path}: expected float32 {shape}, got {array.dtype} {array.shape}")
    return array


@functools.lru_cache(maxsize=4096)
def _checksum(path: Path, size: int, changed: int) -> int:
    # Computed once for each state of a file; states differ in size or time of change.
    return zlib.crc32(path.read_bytes())


def _free_space(path: Path) -> str:
    folder = next((p for p in path.absolute().parents if p.is_dir()), Path(os.curdir))
    with contextlib.suppress(OSError):
        return f" ({shutil.disk_usage(folder).free >> 20} MiB free there)"
    return ""
