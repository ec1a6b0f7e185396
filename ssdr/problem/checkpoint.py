"""Checkpoint: a file with the best model so far, written while the run goes on."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..errors import InputError, SsdrError, SsdrWarning
from ..skinning import Skinning

__all__ = ["Checkpoint"]

_SECONDS = 60.0  # between two writes, and so the most that a killed process loses


class Checkpoint:
    """File ``.npz`` with the best model so far, which is never left half written.

    Parameters
    ----------
    path : str, Path or None
        None: nothing is written.

    Raises
    ------
    InputError
        If the name does not end in ``.npz`` or the folder does not exist.
    """

    def __init__(self, path: Any) -> None:
        self._last = time.monotonic()
        self.path: Path | None = None
        if path is None:
            return
        if not isinstance(path, (str, Path)):
            raise InputError("checkpoint", "the path of an .npz, or None", type(path).__name__)
        self.path = Path(path)
        if self.path.suffix != ".npz" or not self.path.parent.is_dir() or self.path.is_dir():
            raise InputError("checkpoint", "a name ending in .npz in a folder that exists", path)

    def offer(self, skinning: Callable[[], Skinning], *, now: bool = False) -> None:
        """Write the model that `skinning` returns, at most once a minute unless `now` is set.

        If the write fails, as on a full disk, a warning is issued, so that a run of hours goes on.
        """
        if self.path is None or (not now and time.monotonic() - self._last < _SECONDS):
            return
        from ..io.arrays.npz import write_skinning

        try:
            write_skinning(skinning(), self.path, compress=False)
        except (OSError, SsdrError) as error:
            warnings.warn(f"no checkpoint at {self.path}: {error}", SsdrWarning, stacklevel=2)
        self._last = time.monotonic()
