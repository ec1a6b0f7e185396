"""Times of the samples of an Alembic cache, and the frames at which it is read."""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import FormatError
from ..registry import check
from ..sampling import off_frames
from ..signatures import describe

_DEFAULT_RATE = 24.0
_MOST_SAMPLES = 1 << 22
_SAMPLING = struct.Struct("<IdI")  # samples, seconds in a period, stored times
_DATA = 1 << 63  # bit of an address in Ogawa that marks data, not a group


@dataclasses.dataclass(frozen=True, eq=False)
class FrameTimes:
    """Times of the frames at which a cache is read: `count` frames, `rate` per second.

    The first is at `first` seconds. `missed` (N,) holds the times of samples that lie on no frame.
    """

    first: float
    rate: float
    count: int
    missed: NDArray[np.float64]

    @property
    def times(self) -> NDArray[np.float64]:
        return self.first + np.arange(self.count) / self.rate


def sample_times(stored: Sequence[float], period: float, count: int) -> NDArray[np.float64]:
    """Times (S,) in seconds of `count` samples, where the times `stored` repeat every `period`.

    Raises
    ------
    FormatError
        If there are too many samples, or their times do not increase.
    """
    check(0 < count <= _MOST_SAMPLES and len(stored), f"{count} samples at {len(stored)} times")
    cycle, place = np.divmod(np.arange(count), len(stored))
    with np.errstate(over="ignore", invalid="ignore"):
        # the period of times that never repeat is too large to be multiplied by 0
        times = np.asarray(stored, dtype=np.float64)[place] + np.where(cycle, cycle * period, 0.0)
        rising = np.isfinite(times).all() and (np.diff(times) > 0).all()
    check(rising, "its times do not rise")
    return times


def choose_frames(clocks: Iterable[NDArray[np.float64]], fps: float | None) -> FrameTimes:
    """FrameTimes for the samples of several objects, if possible with a frame at each sample.

    The rate is `fps`, if given. Otherwise it is that of the two closest samples, if all samples lie
    on its frames and there are fewer than four frames for each sample. If not, it is the median
    rate of the samples, but at least 24.

    Parameters
    ----------
    clocks : several (S,) arrays
        Times of the samples of each object, in seconds.
    fps : float or None
        Frames per second, or None to choose the rate.
    """
    known = list(clocks)
    moving = [times for times in known if len(times) > 1] or known[:1]
    stamps = np.unique(np.concatenate(moving))
    # equal times of two objects may differ by their rounding
    stamps = stamps[np.diff(stamps, prepend=-np.inf) > 1e-6]
    if len(stamps) < 2:
        return FrameTimes(float(stamps[0]), fps or _DEFAULT_RATE, 1, stamps[:0])
    first, span, gaps = float(stamps[0]), float(np.ptp(stamps)), np.diff(stamps)
    ticks = round(span / float(gaps.min()))
    rate = fps or usual_rate(ticks / span)
    if fps is None and (ticks >= 4 * len(stamps) or len(off_frames(stamps, first, rate))):
        rate = max(_DEFAULT_RATE, usual_rate(1 / float(np.median(gaps))))
    last = span * rate
    # without fps=, the last frame holds the last sample
    count = int(min(last + 1e-3 if fps else math.ceil(last - 0.01), 1e15)) + 1
    return FrameTimes(first, rate, count, off_frames(stamps, first, rate, count))


def usual_rate(rate: float) -> float:
    """`rate` without its rounding, if it is close to a whole or television rate (30 / 1.001)."""
    usual = (float(round(rate)), round(rate * 1.001) / 1.001)
    return next((one for one in usual if one and abs(one - rate) < 1e-7 * one), rate)


def archive_clocks(path: Path) -> list[NDArray[np.float64]]:
    """Sample times of each clock of an archive, read from the file without a library.

    Raises
    ------
    FormatError
        If the file is not Alembic, or is of the old kind HDF5.

    References
    ----------
    Alembic 1.8, ``lib/Alembic/AbcCoreOgawa/ArImpl.cpp`` and ``lib/Alembic/Ogawa``.
    """
    with path.open("rb") as stream:

        def numbers(kind: str, start: int) -> tuple[int, ...]:
            stream.seek(start)
            return struct.unpack(kind, stream.read(struct.calcsize(kind)))

        check_kind(stream.read(16))
        (root,) = numbers("<Q", 8)
        (address,) = numbers("<Q", root + 8 * 5)  # of the fifth child, after the count of children
        start = address & ~_DATA
        (size,) = numbers("<Q", start)
        whole = address & _DATA and start + 8 + size <= path.stat().st_size
        check(whole, "it states no times")
        data = stream.read(size)
    clocks, start = [], 0
    while start < len(data):
        count, period, n_stored = _SAMPLING.unpack_from(data, start)
        start += _SAMPLING.size
        stored = np.frombuffer(data, dtype="<f8", count=n_stored, offset=start)
        start += stored.nbytes
        if count:
            clocks.append(sample_times(stored.tolist(), period, count))
    check(clocks, "it states no times")
    return clocks


def check_kind(head: bytes) -> None:
    """Raise a FormatError unless a file that begins with `head` is Alembic of the kind Ogawa."""
    if head.startswith(b"\x89HDF"):
        raise FormatError(
            "an Alembic file of the old kind HDF5, which neither alembic3d nor Blender reads; "
            "abcconvert -toOgawa OLD NEW of the Alembic library converts it"
        )
    check(head.startswith(b"Ogawa"), f"not an .abc file: {describe(head)}")
