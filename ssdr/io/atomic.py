"""Files appear whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
import uuid
from collections.abc import Iterator
from pathlib import Path

from ..errors import InputError

__all__ = [
    "atomic_path",
    "check_writable",
    "free_name",
    "naming",
    "remove",
    "write_bytes",
    "written_file",
]

_LONGEST_NAME = 255  # bytes; of every file system in common use
# What writing to an open file fails with: the system names no file then.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextlib.contextmanager
def atomic_path(path: Path | str, *, flush: bool = True) -> Iterator[Path]:
    """Yield a free name in the folder of `path`; what was written there becomes `path`.

    The name has the suffix of `path`, for writers that look at it.  If the
    block raises, `path` is untouched and the temporary file is removed.  Where
    `path` is a symbolic link, the file that it leads to is replaced and the link
    stays.

    Parameters
    ----------
    path : path
    flush : bool
        Have the file on the disk before it gets its name, and its name before this
        returns: after a power cut there is the old file or the new one.  For
        hundreds of files that are written in a row, this is slow.

    Raises
    ------
    InputError
        If the folder does not exist or `path` is no file.
    OSError
        If it cannot be written; names `path`.
    """
    target = written_file(path)
    temporary = free_name(target)
    try:
        with naming(path, temporary):
            yield temporary
            if flush:
                _flush(temporary)
            os.replace(temporary, target)
            if flush:
                _flush(target.parent)
    except BaseException:
        remove(temporary)
        raise


@contextlib.contextmanager
def naming(path: Path | str, temporary: Path) -> Iterator[None]:
    """Have the system's errors inside the block name `path`: on a full disk they name nothing."""
    try:
        yield
    except OSError as error:
        nameless = error.filename is None and error.errno in _FULL
        if nameless or str(error.filename).startswith(str(temporary)):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise


def written_file(path: Path | str) -> Path:
    """The file that writing to `path` replaces: where links lead, in a folder that exists.

    Raises
    ------
    InputError
        If there is no such folder, or a folder, a device or a pipe has that name.
    """
    link = Path(path)
    try:
        target = link.resolve() if link.is_symlink() else link
        if target.is_symlink():
            raise InputError("path", "the name of a file", f"{link}, a circle of links")
        if not target.parent.is_dir():
            raise InputError("path", "a file in a folder that exists", str(target))
        if target.is_dir():
            raise InputError("path", "the name of a file", f"the folder {target}")
        if target.exists() and not stat.S_ISREG(target.stat().st_mode):
            raise InputError("path", "the name of a file", f"the device or pipe {target}")
    except (RuntimeError, OSError) as error:  # a circle of links, a name that is too long
        raise InputError("path", "the name of a file", f"{link} ({error})") from error
    return target


def check_writable(path: Path | str) -> None:
    """Find out, before hours of work, whether a file can be made there.

    Raises
    ------
    InputError
        As :func:`written_file`, or if the folder takes no new file.
    """
    target = written_file(path)
    probe = free_name(target)
    try:
        # The name itself as well: that of the temporary file is cut to what fits.
        os.stat(target)
    except FileNotFoundError:
        pass
    except OSError as error:
        raise InputError("path", "a file that can be written", f"{path} ({error})") from error
    try:
        probe.touch()
    except OSError as error:
        raise InputError(
            "path", "a file in a folder that can be written to", f"{path} ({error.strerror})"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            remove(probe)


def write_bytes(path: Path | str, data: bytes, *, flush: bool = True) -> int:
    """Write `data` to `path` at once, as :func:`atomic_path` does; the number of bytes."""
    with atomic_path(path, flush=flush) as temporary:
        return temporary.write_bytes(data)


def free_name(target: Path) -> Path:
    """A hidden name beside `target` that no other process uses, of the same suffix."""
    # Not tempfile: it would leave the result readable by its owner alone.
    mark = f"{os.getpid()}-{uuid.uuid4().hex[:8]}"
    most = _LONGEST_NAME - len(os.fsencode(f"..{mark}{target.suffix}"))
    stem = os.fsencode(target.stem)[: max(most, 0)].decode("utf-8", "ignore")
    return target.with_name(f".{stem}.{mark}{target.suffix}")


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    """Have the system write a file or a folder's list of names to the disk."""
    folder = path.is_dir()
    if folder and os.name != "posix":  # only there can a folder be opened
        return
    number = os.open(path, os.O_RDONLY if folder else os.O_RDWR)
    try:
        os.fsync(number)
    except OSError as error:
        # Network and pseudo file systems that know no such thing say so; that is no failure.
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS):
            raise
    finally:
        os.close(number)
