"""A cache of arrays on disk, and progress."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ssdr.io.arrays.array_files import read_arrays, write_arrays

# Called with a text that says what is being done, and the fraction that is done.
Progress = Callable[[str, float], None]


def silent(text: str, fraction: float) -> None:
    """Progress that nobody sees."""


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
        write_arrays(path, made, compress=False)
    return read_arrays(path, required=(), optional=("*",))
