"""Lookup of files that another file names, limited to the folder of that file.

Without this limit, a model from elsewhere could name any file of the machine that reads it, and the
contents of that file would go into an output.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from pathlib import Path

_log = logging.getLogger(__name__)


def is_inside(file: Path, folder: Path) -> bool:
    """Whether a file lies in a folder or below it, once symbolic links are followed."""
    return file.resolve().is_relative_to(folder.resolve())


def locate(path: Path, name: str) -> tuple[Path, str]:
    """File that `path` refers to as `name`, and the reason not to read it ("" if there is none).

    A pipe, a device and a name that no file can have count as missing.
    """
    file = path.parent / name
    try:
        if not is_inside(file, path.parent):
            return file, "lies outside its folder"
        return file, "" if file.is_file() else "is missing"
    except (OSError, ValueError, RuntimeError):
        return file, "is missing"


def find_inside(path: Path, what: str, spellings: Iterable[str]) -> Path | None:
    """First existing file of several names in the folder of `path` or below it, or None.

    If there is none, or only one outside that folder, a warning is logged.

    Parameters
    ----------
    path : Path
        File that refers to the other.
    what : str
        Kind of the other file, for the warning.
    spellings : iterable of str
        Names to try, in this order.
    """
    names = list(spellings)
    found = [locate(path, name) for name in names]
    for file, problem in found:
        if not problem:
            return file
    problem = next((p for f, p in found if p != "is missing" and f.is_file()), "is missing")
    _log.warning("%s: its %s %s %s and is left out", path, what, names[0][:200], problem)
    return None
