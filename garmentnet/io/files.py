"""What is written to disk, and a clear word where that fails."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from ssdr.errors import SsdrError
from ssdr.io.atomic import atomic_path, write_bytes

__all__ = ["atomic_file", "write_file", "writing"]


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn what a full or protected disk raises inside the block into an error that names the file.

    Libraries say it in their own ways: safetensors has an error class of its own for it.
    """
    try:
        yield
    except SsdrError:
        raise
    except Exception as error:
        if not (isinstance(error, OSError) or "I/O error" in str(error)):
            raise
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise SsdrError(f"{path}: could not be written: {reason}{_room(path)}") from error


@contextlib.contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """As :func:`ssdr.io.atomic.atomic_path`, with the errors of :func:`writing`."""
    with writing(path), atomic_path(path) as temporary:
        yield temporary


def write_file(path: Path, data: bytes) -> None:
    """Write a file at once, with the errors of :func:`writing`."""
    with writing(path):
        write_bytes(path, data)


def _room(path: Path) -> str:
    folder = next((p for p in path.absolute().parents if p.is_dir()), Path(os.curdir))
    with contextlib.suppress(OSError):
        return f" ({shutil.disk_usage(folder).free >> 20} MiB free there)"
    return ""
