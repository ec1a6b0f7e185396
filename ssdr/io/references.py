"""Lookup of files that another file names, limited to the folder of that file.

A model from elsewhere may name any file of the machine that reads it, whose contents would
then go into an output.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from pathlib import Path

__all__ = ["find_inside", "is_inside"]

_log = logging.getLogger(__name__)


def is_inside(file: Path, folder: Path) -> bool:
    """Whether a file lies in a folder or below it, wherever links lead."""
    return file.resolve().is_relative_to(folder.resolve())


def find_inside(path: Path, what: str, spellings: Iterable[str]) -> Path | None:
    """First of several names that is a file in the folder of `path` or below it.

    Logs a warning if there is none, or only one outside.

    Parameters
    ----------
    path : Path
        File that names the other.
    what : str
        Kind of the other file, for the warning.
    spellings : iterable of str
        Names to try, in this order.
    """
    names = list(spellings)
    outside = False
    for name in names:
        try:
            file = path.parent / name
            if not file.is_file():
                continue
            if is_inside(file, path.parent):
                return file
            outside = True
        except (OSError, ValueError, RuntimeError):  # a name that no file can have
            continue
    state = "lies outside its folder and is left out" if outside else "is not there"
    _log.warning("%s: its %s %s %s", path, what, names[0][:200], state)
    return None
