"""Writing of files so that they appear complete or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

from ..common.errors import InputError

_PREFIX = ".ssdr-"  # of the names of temporary files
_STALE_SECONDS = 3600.0  # no write goes on for so long without a change of its file


@contextlib.contextmanager
def atomic_path(path: Path | str, *, flush: bool = True) -> Iterator[Path]:
    """Context with a temporary file that becomes `path` when the block ends without an error.

    The temporary file lies in the folder of `path` and has its suffix, because some writers choose
    the format by it. If the block raises an exception, `path` is untouched and the temporary file
    is removed. If the process is killed, the temporary file stays until a file is written to
    its folder an hour or more later. If `path` is a symbolic link, the file that it points to is
    replaced and the link stays.

    Parameters
    ----------
    path : path
    flush : bool
        Force the file to the disk before it is renamed, and the new name before the block is left,
        so that after a power cut there is the old file or the new one. Also remove temporary files
        that killed processes left. Slow for hundreds of files.

    Raises
    ------
    InputError
        If the folder does not exist, or `path` is a folder or a device.
    OSError
        If the file cannot be written; the error names `path`.
    """
    target = _file_behind(path)
    temporary = free_name(target)
    if flush:
        _remove_stale(target.parent)
    try:
        yield temporary
        if flush:
            _flush(temporary)
        os.replace(temporary, target)
        if flush and os.name == "posix":  # other systems cannot open a folder
            _flush(target.parent)
    except OSError as error:
        # while an open file is written to, as on a full disk, an error names no file
        if error.strerror and str(error.filename or temporary).startswith(str(temporary)):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
    finally:
        remove(temporary)


def check_writable(path: Path | str) -> None:
    """Raise an InputError if no file can be made at `path`; to be called before hours of work.

    Raises
    ------
    InputError
        If `path` cannot name a file, or no file can be created in its folder.
    """
    probe = free_name(_file_behind(path))
    try:
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(
            "path", "a file in a folder that can be written to", f"{path} ({error.strerror})"
        ) from error


def write_bytes(path: Path | str, data: bytes, *, flush: bool = True) -> int:
    """Write `data` to `path` through :func:`atomic_path`, and return the number of bytes."""
    with atomic_path(path, flush=flush) as temporary:
        return temporary.write_bytes(data)


def free_name(target: Path) -> Path:
    """Hidden path beside `target`, with the same suffix, that no other process uses."""
    # tempfile would make a file that its owner alone can read.
    return target.with_name(f"{_PREFIX}{uuid.uuid4().hex[:12]}{target.suffix}")


def _remove_stale(folder: Path) -> None:
    """Remove the temporary files that killed processes left in a folder over an hour ago."""
    with contextlib.suppress(OSError):  # another process may remove them at the same time
        for left in folder.glob(f"{_PREFIX}*"):
            if left.is_file() and time.time() - left.stat().st_mtime > _STALE_SECONDS:
                left.unlink()


def remove(path: Path) -> None:
    """Remove a file or a folder, if it exists."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _file_behind(path: Path | str) -> Path:
    """Path that a write to `path` replaces: the end of its symbolic links, or `path` itself."""
    link = Path(path)
    try:
        target = link.resolve() if link.is_symlink() else link
        if not target.parent.is_dir():
            raise InputError("path", "a file in a folder that exists", str(target))
        if target.is_dir():
            raise InputError("path", "the name of a file", f"the folder {target}")
        if target.is_symlink() or (target.exists() and not target.is_file()):
            raise InputError(
                "path", "the name of a file", f"{target}, a device, a pipe or a circle"
            )
    except InputError:
        raise
    except (RuntimeError, OSError, ValueError) as error:  # a circle of links, a name too long
        raise InputError("path", "the name of a file", f"{link} ({error})") from error
    return target


def _flush(path: Path) -> None:
    """Force a file, or the list of names in a folder, from the system's memory to the disk."""
    number = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(number)
    except OSError as error:
        # Some network and pseudo file systems have no fsync, which is not an error here.
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS):
            raise
    finally:
        os.close(number)
