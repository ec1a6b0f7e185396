"""Report on a written file, and the error that its format adds by rounding positions."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError

_BLOCK_BYTES = 64 << 20  # bytes of float64 positions in a block: more only takes more memory


@dataclasses.dataclass(frozen=True, kw_only=True)
class SaveReport:
    """What :func:`ssdr.save` wrote: size, error of the format's storage, and what to know of it.

    Attributes
    ----------
    path : Path
        The file; for numbered files, their pattern.
    bytes : int
        Size of all that was written.
    error : float
        Root mean square sqrt(Σ |d|² / (F V)) of the distances |d| between the stored and the given
        vertices, in the units of the latter; 0 if the file is exact.
    max_error : float
        Largest of these distances.
    between_frames : float or None
        Root mean square distance of vertices halfway between two frames, where an engine
        interpolates the bones, from the mean of the given vertices in both frames. None if the file
        has no bones that an engine interpolates.
    notes : tuple of str
        Sentences on the file: what was converted, taken for something, put beside it or left out.
    lost : tuple of str
        Contents that the file should have and does not, such as those of a template.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     report = ssdr.save(ssdr.samples.load("dancer_small"), f"{folder}/dancer.npz")
    ...     report.bytes == report.path.stat().st_size
    True
    """

    path: Path
    bytes: int
    error: float = 0.0
    max_error: float = 0.0
    between_frames: float | None = None
    notes: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()


def frame_blocks(start: int, stop: int, n_vertices: int) -> Iterator[slice]:
    """Split `start` to `stop` into slices of at most 64 MiB of float64 positions, or one frame."""
    step = max(1, _BLOCK_BYTES // (24 * n_vertices))
    for first in range(start, stop, step):
        yield slice(first, min(first + step, stop))


class Rounding:
    """Accumulates the RMS and largest distance of stored from given vertices."""

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
        size = path.stat().st_size
        return SaveReport(path=path, bytes=size, error=self.rmse, max_error=self.largest, **fields)

    @property
    def rmse(self) -> float:
        """Root mean square of all distances added; 0 if there are none."""
        return math.sqrt(self._squares / max(self._count, 1))

    @property
    def largest(self) -> float:
        """Largest of all distances added; 0 if there are none."""
        return math.sqrt(self._largest)
