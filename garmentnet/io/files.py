"""Errors of writing that name the file, and arrays that are kept on disk."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ssdr.errors import SsdrError
from ssdr.io.arrays.archive import read_arrays, write_arrays
from ssdr.io.atomic import write_bytes

__all__ = ["kept", "write_file", "writing"]


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


def kept(path: Path, make: Callable[[], dict[str, Any]]) -> dict[str, NDArray[Any]]:
    """Arrays of an ``.npz`` file, which is made and written first where it is missing.

    Raises
    ------
    FormatError
        If the file is damaged; without it, it is made again.
    """
    if not path.is_file():
        made = make()
        path.parent.mkdir(parents=True, exist_ok=True)
        with writing(path):
            write_arrays(path, made, compress=False)
    return read_arrays(path, required=(), optional=("*",))


def _free_space(path: Path) -> str:
    folder = next((p for p in path.absolute().parents if p.is_dir()), Path(os.curdir))
    with contextlib.suppress(OSError):
        return f" ({shutil.disk_usage(folder).free >> 20} MiB free there)"
    return ""
