"""Writing of files with errors that name them, and a cache of arrays on disk."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ssdr.common.errors import SsdrError
from ssdr.io.arrays.array_files import read_arrays, write_arrays
from ssdr.io.atomic import write_bytes

# Called with a text that says what is being done, and the fraction that is done.
Progress = Callable[[str, float], None]


def silent(text: str, fraction: float) -> None:
    """Progress that nobody sees."""


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Context that turns errors of a full or protected disk into an error that names the file.

    Libraries raise different errors in that case; safetensors has a class of its own.

    Raises
    ------
    SsdrError
        If the file could not be written; the message has the reason and the free space.  Errors of
        other kinds are not changed.
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
    """Arrays of an ``.npz`` file; if it does not exist, `make` computes them and they are written.

    Raises
    ------
    FormatError
        If the file is damaged; it is made again once it has been removed.
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
