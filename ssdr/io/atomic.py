"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

from ..errors import InputError

_LONGEST_NAME = 255  # bytes, in every file system in common use
_STALE_SECONDS = 3600.0  # no write goes on for so long without a change of its file


@contextlib.contextmanager
def atomic_path(path: Path | str, *, flush: bool = True) -> Iterator[Path]:
    """Temporary file that becomes `path` when the block ends without an error.

    It lies in the same folder and has the suffix of `path`, for writers that look at it.
    If the block raises, `path` is untouched and the temporary file is removed.  A process that
    is killed leaves it, until `path` is written again an hour or more later.  Where `path` is a
    symbolic link, the file at its end is replaced and the link stays.

    Parameters
    ----------
    path : path
    flush : bool
        Write the file to the disk before the renaming and the renaming before this returns, so
        that a power cut leaves the old file or the new one, and look for files that killed
        processes left.  Slow for hundreds of files.

    Raises
    ------
    InputError
        If the folder does not exist or `path` is no file.
    OSError
        If the file cannot be written; the error names `path`.
    """
    target = _file_behind(path)
    temporary = free_name(target)
    if flush:
        _remove_stale(target)
    try:
        with naming(path, temporary):
            yield temporary
            if flush:
                _flush(temporary)
            os.replace(temporary, target)
            if flush and os.name == "posix":  # other systems cannot open a folder
                _flush(target.parent)
    except BaseException:
        remove(temporary)
        raise


@contextlib.contextmanager
def naming(path: Path | str, temporary: Path) -> Iterator[None]:
    """Name `path` in the system's errors inside the block, instead of `temporary` or no file.

    An error of writing to an open file, such as a full disk, names no file.
    """
    try:
        yield
    except OSError as error:
        if error.strerror and str(error.filename or temporary).startswith(str(temporary)):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


def check_writable(path: Path | str) -> None:
    """Refuse a path at which no file can be made, before hours of work.

    Raises
    ------
    InputError
        If `path` is no name of a file or its folder takes no new file.
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
    """Write `data` to `path` as :func:`atomic_path` does; returns the number of bytes."""
    with atomic_path(path, flush=flush) as temporary:
        return temporary.write_bytes(data)


def free_name(target: Path) -> Path:
    """Hidden name beside `target`, of the same suffix, that no other process uses."""
    # tempfile would make a file that its owner alone can read.
    mark = f"{os.getpid()}-{uuid.uuid4().hex[:8]}"
    most = _LONGEST_NAME - len(os.fsencode(f"..{mark}{target.suffix}"))
    stem = os.fsencode(target.stem)[: max(most, 0)].decode("utf-8", "ignore")
    return target.with_name(f".{stem}.{mark}{target.suffix}")


def _remove_stale(target: Path) -> None:
    """Remove the temporary files of `target` that killed processes left over an hour ago."""
    start, end = re.escape(f".{target.stem}."), re.escape(target.suffix)
    with contextlib.suppress(OSError):  # another process may remove them at the same time
        for entry in os.scandir(target.parent):
            left = re.fullmatch(rf"{start}[0-9]+-[0-9a-f]{{8}}{end}", entry.name)
            if left and entry.is_file() and time.time() - entry.stat().st_mtime > _STALE_SECONDS:
                os.unlink(entry)


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _file_behind(path: Path | str) -> Path:
    """File that a write to `path` replaces: the one at the end of its symbolic links."""
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
    """Have the system write a file, or a folder's list of names, to the disk."""
    number = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(number)
    except OSError as error:
        # Network and pseudo file systems without fsync say so, which is no failure.
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS):
            raise
    finally:
        os.close(number)
