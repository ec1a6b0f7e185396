"""Error of a format's storage, summed over blocks of frames."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

_BLOCK_BYTES = 64 << 20  # bytes of float64 positions in a block: more only takes more memory


def frame_blocks(start: int, stop: int, n_vertices: int) -> Iterator[slice]:
    """Consecutive ranges of frames whose float64 positions take little memory."""
    step = max(1, _BLOCK_BYTES // (24 * n_vertices))
    for first in range(start, stop, step):
        yield slice(first, min(first + step, stop))


class StorageError:
    """Distances between vertices as stored and as given."""

    def __init__(self) -> None:
        self._squares, self._count, self._largest = 0.0, 0, 0.0

    def add(self, stored: NDArray[np.floating], given: NDArray[np.floating]) -> None:
        """Count a block of frames ``(F, V, 3)``."""
        squares = ((np.asarray(stored, dtype=np.float64) - given) ** 2).sum(axis=2)
        self._squares += float(squares.sum())
        self._count += squares.size
        self._largest = max(self._largest, float(squares.max()))

    def round(self, block: NDArray[np.floating], first: int) -> NDArray[np.float32]:
        """Round a block that begins with frame `first` to float32, and count its error.

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

    @property
    def rmse(self) -> float | None:
        """Root mean square distance; None if nothing was counted."""
        return math.sqrt(self._squares / self._count) if self._count else None

    @property
    def largest(self) -> float | None:
        """Largest distance of a vertex; None if nothing was counted."""
        return math.sqrt(self._largest) if self._count else None
