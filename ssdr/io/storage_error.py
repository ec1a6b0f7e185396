"""Error that a file format adds by rounding positions, summed over blocks of frames."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .registry import SaveReport

_BLOCK_BYTES = 64 << 20  # bytes of float64 positions in a block: more only takes more memory


def frame_blocks(start: int, stop: int, n_vertices: int) -> Iterator[slice]:
    """Split `start` to `stop` into slices of at most 64 MiB of float64 positions, or one frame."""
    step = max(1, _BLOCK_BYTES // (24 * n_vertices))
    for first in range(start, stop, step):
        yield slice(first, min(first + step, stop))


class StorageError:
    """Accumulates the RMS and largest distance of stored from given vertices (not an exception)."""

    def __init__(self) -> None:
        self._squares, self._count, self._largest = 0.0, 0, 0.0

    def add(self, stored: NDArray[np.floating], given: NDArray[np.floating]) -> None:
        """Add the distances between two blocks of frames ``(F, V, 3)``, `stored` and `given`."""
        squares = ((np.asarray(stored, dtype=np.float64) - given) ** 2).sum(axis=2)
        self._squares += float(squares.sum())
        self._count += squares.size
        self._largest = max(self._largest, float(squares.max()))

    def round(self, block: NDArray[np.floating], first: int) -> NDArray[np.float32]:
        """Round `block` to float32, count the rounding distances in the statistics, and return it.

        `first` is the index of the block's first frame, for the error message.

        Raises
        ------
        InputError
            If a coordinate is beyond the range of float32.
        """
        with np.errstate(over="ignore"):
            stored = block.astype(np.float32)
        if not np.isfinite(stored).all():
            frames = f"larger ones in frames {first} to {first + len(block) - 1}"
            raise InputError("thing", "coordinates that float32 can hold", frames)
        self.add(stored, block)
        return stored

    def report(self, path: Path, **fields: Any) -> SaveReport:
        """Report on the file `path`, with these distances as its error and further `fields`."""
        size, error, most = path.stat().st_size, self.rmse or None, self.largest or None
        return SaveReport(path=path, bytes=size, error=error, max_error=most, **fields)

    @property
    def rmse(self) -> float | None:
        """Root mean square of all distances added, or None if there are none."""
        return math.sqrt(self._squares / self._count) if self._count else None

    @property
    def largest(self) -> float | None:
        """Largest of all distances added, or None if there are none."""
        return math.sqrt(self._largest) if self._count else None
