"""Frames at which a file's motion is read: their rate, their times, and the keys between them.

Frames follow each other at one rate, but the keys or samples of a file need not.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError

DEFAULT_RATE = 24.0  # frames per second of a file that states and implies none
# frames per second in use in film, television and motion capture
_RATES = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 100.0, 120.0)
_ON = 0.01  # frames: a time closer than this, as after rounding to float32, lies on a frame

Times = NDArray[np.float64]
Range = tuple[float, float] | None


@dataclasses.dataclass(frozen=True, eq=False)
class Frames:
    """The `count` frames of a clip, at the times ``first + k / rate``.

    `missed` (N,) holds the times of the keys that lie on none of these frames, and `tempo` how many
    frames the file itself counts in a unit of time, by default `rate`.
    """

    first: float
    rate: float
    count: int
    missed: Times
    tempo: float | None = None

    @property
    def times(self) -> Times:
        return np.asarray(self.first + np.arange(self.count) / self.rate)

    @property
    def numbers(self) -> Times:
        """Numbers (F,) of the frames, as the file counts them from its time 0 on."""
        return self.times * (self.tempo or self.rate)

    def within(self, wanted: Range) -> Frames:
        """These frames, without those whose own numbers lie outside the range `wanted`.

        Raises
        ------
        InputError
            If none is left.
        """
        if wanted is None:
            return self
        kept = frames_in(wanted, self.numbers)
        first, last = self.times[kept[[0, -1]]]
        inside = (self.missed > first) & (self.missed < last)
        return dataclasses.replace(
            self, first=float(first), count=len(kept), missed=self.missed[inside]
        )


def parse_range(frames: str | Sequence[float] | None) -> Range:
    """First and last frame of ``"10:50"`` or of two numbers; None if all are wanted.

    Raises
    ------
    InputError
        If it is anything else, or the last comes before the first.
    """
    if frames is None:
        return None
    expected = "the first and the last frame, as 10:50 or (10, 50)"
    try:
        first, last = map(float, frames.split(":") if isinstance(frames, str) else frames)
        if -math.inf < first <= last < math.inf:
            return first, last
    except (TypeError, ValueError):
        pass
    raise InputError("frames", expected, repr(frames))


def frames_in(wanted: tuple[float, float], numbers: Times) -> NDArray[np.int64]:
    """Indices of the frames whose `numbers` (F,) lie in a range, its ends included.

    Raises
    ------
    InputError
        If there is none.
    """
    inside = (numbers > wanted[0] - _ON) & (numbers < wanted[1] + _ON)
    if not inside.any():
        held = f"some of the frames {numbers.min():g} to {numbers.max():g}"
        raise InputError("frames", held, "{:g} to {:g}".format(*wanted))
    return np.flatnonzero(inside)


def off_frames(stamps: Times, first: float, rate: float, count: int | None = None) -> Times:
    """Times among `stamps` that lie on no frame.

    Frames are at ``first + k / rate``, with k below `count` if that is given.
    """
    ticks = (stamps - first) * rate
    nearest = np.clip(np.rint(ticks), 0, np.inf if count is None else count - 1)
    return np.asarray(stamps[np.abs(ticks - nearest) >= _ON])


def frames_between(
    stamps: Times, first: float, last: float, rate: float, *, asked: bool = False
) -> Frames:
    """Frames from `first` to `last` at a rate, for keys at the times `stamps`.

    If keys lie between these frames, a further frame holds the last key, unless the caller has
    `asked` for this rate.
    """
    ticks = min((last - first) * rate, 1e15)
    count = math.floor(ticks + 1e-3) + 1
    if not asked and len(off_frames(stamps, first, rate, count)):
        count = math.ceil(ticks - _ON) + 1
    return Frames(first, rate, count, off_frames(stamps, first, rate, count))


def usual_rate(rate: float, within: float = 1e-7) -> float:
    """`rate` without its rounding, if it is close to a whole or a television rate (30 / 1.001).

    `within` is the largest relative difference from a whole rate.
    """
    whole, television = float(round(rate)), round(rate * 1.001) / 1.001
    if whole and abs(rate - whole) < within * whole:
        return whole
    return television if television and abs(rate - television) < 1e-7 * television else rate


def frame_rate(stamps: Times, stated: float | None = None) -> float | None:
    """Frames per second of ascending key times (in seconds), or None if no rate is found.

    It is the first of these rates: the one that the file has `stated`, or that of the closest two
    keys, if all keys fall on its frames; the rate at which more than three in four keys follow each
    other, even if the others lie between its frames; the first usual rate on whose frames all keys
    fall. Rates below 10 that are not stated are not accepted, because sparse keys alone would
    suggest them.
    """
    closest = common = None
    gaps = np.diff(stamps)
    gaps = gaps[gaps > 1e-4]
    if len(gaps):
        span = float(stamps[-1] - stamps[0])
        closest = usual_rate(round(span / float(gaps.min())) / span, 1e-4)
        alike = np.abs(gaps / np.median(gaps) - 1) < 0.01
        common = usual_rate(1 / float(gaps[alike].mean()), 1e-4) if alike.mean() > 0.75 else None
    elif stated is None:
        return None
    for rate in (stated, closest, common, *_RATES):
        if not rate or not (rate == stated or 10 <= rate <= 1000):
            continue
        if rate == common or not len(off_frames(stamps, float(stamps[0]), rate)):
            return rate
    return None


def sample_frames(stamps: Times, fps: float | None) -> Frames:
    """Frames of ascending times of samples, each of which is a frame if that is possible.

    The rate is `fps`, if given. Otherwise it is that of the two closest samples, if all samples lie
    on its frames and there are fewer than four frames for each sample. If not, it is the median
    rate of the samples, but at least 24.
    """
    first, last = float(stamps[0]), float(stamps[-1])
    if len(stamps) < 2:
        return Frames(first, fps or DEFAULT_RATE, 1, stamps[:0])
    gaps = np.diff(stamps)
    ticks = round((last - first) / float(gaps.min()))
    rate = fps or usual_rate(ticks / (last - first))
    if not fps and (ticks >= 4 * len(stamps) or len(off_frames(stamps, first, rate))):
        rate = max(DEFAULT_RATE, usual_rate(1 / float(np.median(gaps))))
    return frames_between(stamps, first, last, rate, asked=fps is not None)
