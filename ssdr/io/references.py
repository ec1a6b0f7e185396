"""Lookup of files that another file names, limited to the folder of that file.

Without this limit, a model from elsewhere could name any file of the machine that reads it, and the
contents of that file would go into an output. The user may name a further folder.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from ..common.errors import InputError

OUTSIDE = "lies outside its folder"
HINT = "folder= names a folder that may be read, too"
_trusted: ContextVar[tuple[Path, ...]] = ContextVar("trusted", default=())


@contextlib.contextmanager
def trusting(folder: Any) -> Iterator[None]:
    """Context in which files may refer to files below `folder`, besides those in their own folder.

    None adds no folder.
    """
    token = _trusted.set(_trusted.get())
    try:
        if folder is not None:
            trust(folder)
        yield
    finally:
        _trusted.reset(token)


def trust(folder: Any) -> None:
    """Let files below `folder` be read where others refer to them, in the current `trusting` block.

    Raises
    ------
    InputError
        If there is no such folder.
    """
    if not isinstance(folder, (str, os.PathLike)) or not os.path.isdir(folder):
        raise InputError("folder", "a folder that exists", repr(folder))
    _trusted.set((*_trusted.get(), Path(folder)))


def is_inside(file: Path, folder: Path) -> bool:
    """Whether a file lies in or below a folder, or a trusted one, once links are followed."""
    place = file.resolve()
    return any(place.is_relative_to(one.resolve()) for one in (folder, *_trusted.get()))


def folders_of(path: Path) -> list[str]:
    """Folders in or below which a file may refer to others: its own, and the trusted ones."""
    return [str(folder.resolve()) for folder in (path.parent, *_trusted.get())]


def locate(path: Path, name: str) -> tuple[Path, str]:
    """File that `path` refers to as `name`, and the reason not to read it ("" if there is none).

    A pipe, a device and a name that no file can have count as missing.
    """
    file = path.parent / name
    try:
        if not is_inside(file, path.parent):
            return file, OUTSIDE
        return file, "" if file.is_file() else "is missing"
    except (OSError, ValueError, RuntimeError):
        return file, "is missing"
