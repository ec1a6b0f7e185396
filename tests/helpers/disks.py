"""Disks that are full: files that grow no further than a limit, and folders that take none."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from ssdr.io import atomic


@contextlib.contextmanager
def small_files(limit: int) -> Iterator[None]:
    """Limit the size of every file that this process writes, in bytes."""
    resource = pytest.importorskip("resource", reason="no limits of that kind here")
    old = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, old[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old)


def fill(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make every later flush of a file in `folder` fail as on a full disk."""
    real = atomic._flush

    def flush(path: Path) -> None:
        if path.parent.resolve() == folder.resolve() and path.is_file():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(path)

    monkeypatch.setattr(atomic, "_flush", flush)
