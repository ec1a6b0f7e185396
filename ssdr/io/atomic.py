"""Files appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
import uuid
from collections.abc import Iterator
from pathlib import Path

from ..errors import InputError

__all__ = ["atomic_path", "free_name", "remove", "write_bytes"]


@contextlib.contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a free name in the folder of `path`; what was written there becomes `path`.

    The name has the suffix of `path`, for writers that look at it.  If the
    block raises, `path` is untouched and the temporary file is removed.

    Raises
    ------
    InputError
        If the folder does not exist or `path` is a folder.
    """
    target = Path(path)
    if not target.parent.is_dir():
        raise InputError("path", "a file in a folder that exists", str(target))
    if target.is_dir():
        raise InputError("path", "the name of a file", f"the folder {target}")
    temporary = free_name(target)
    try:
        yield temporary
        os.replace(temporary, target)
    except BaseException:
        remove(temporary)
        raise


def write_bytes(path: Path | str, data: bytes) -> int:
    """Write `data` to `path` at once; the number of bytes."""
    with atomic_path(path) as temporary:
        return temporary.write_bytes(data)


def free_name(target: Path) -> Path:
    """A hidden name beside `target` that no other process uses, of the same suffix."""
    # Not tempfile: it would leave the result readable by its owner alone.
    return target.with_name(f".{target.stem}.{os.getpid()}-{uuid.uuid4().hex[:8]}{target.suffix}")


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
