"""Frames at which the clips of a file are sampled, and what is lost between them.

Frames follow each other at one rate, and key times of a file need not. If the key times do not, the
file is sampled, and a warning states the largest error of vertices that results.
"""

from __future__ import annotations

import dataclasses
import logging
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..clips import Clip
from ..errors import SsdrWarning

_log = logging.getLogger(__name__)
_ON = 0.01  # frames: a time closer than this, as after rounding to float32, lies on a frame
_MOST_LOOKS, _MOST_BYTES = 256, 64 << 20  # limits of the key times at which vertices are compared
_LEAST = 1e-6  # of the diagonal: rounding of float32 vertices

Times = NDArray[np.float64]


def off_frames(stamps: Times, first: float, rate: float, count: int | None = None) -> Times:
    """Times among `stamps` that lie on no frame.

    Frames are at ``first + k / rate``, with k below `count` if that is given.
    """
    ticks = (stamps - first) * rate
    nearest = np.clip(np.rint(ticks), 0, np.inf if count is None else count - 1)
    return np.asarray(stamps[np.abs(ticks - nearest) >= _ON])


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Missed:
    """Key times of a clip that lie on none of its frames.

    Attributes
    ----------
    path : Path
    times : (N,) float64
    first, rate : float
        Time of the first frame, and frames in a unit of time.
    own : bool
        Whether the reader chose the frame rate, since the caller gave none.
    at : callable
        Function from n times to the `time` of a sample with these frames.
    """

    path: Path
    times: Times
    first: float
    rate: float
    own: bool
    at: Callable[[Times], Any]


@dataclasses.dataclass(frozen=True, eq=False)
class Sample:
    """One clip of a scene, with the parts to show in it.

    Attributes
    ----------
    clip : Clip
    parts : sequence of ScenePart
        The same parts in every clip of a file.
    time : object
        Frames of the clip, in the form that the parts of this file format take.
    missed : Missed
    """

    clip: Clip
    parts: Sequence[Any]
    time: Any
    missed: Missed

    def tell_missed(self, vertices_of: Callable[..., NDArray[np.floating]]) -> None:
        """Warn of keys between frames, with the largest error of vertices at these keys.

        The error is the distance between the vertices at a key and those interpolated linearly
        between the two frames around it, as players do. At most 256 keys are compared.

        Parameters
        ----------
        vertices_of : callable
            The function :func:`ssdr.io.scene.vertices_of`.
        """
        missed, width = self.missed, sum(len(part.indices) for part in self.parts)
        if not len(missed.times) or not (missed.own or _log.isEnabledFor(logging.INFO)):
            return

        def vertices(times: Times) -> NDArray[np.floating]:
            return vertices_of(self.parts, missed.at(times), len(times))

        looks = min(len(missed.times), _MOST_LOOKS, max(1, _MOST_BYTES // (12 * width)))
        chosen = missed.times[np.linspace(0, len(missed.times) - 1, looks).astype(int)]
        ticks = np.clip((chosen - missed.first) * missed.rate, 0, self.clip.n_frames - 1)
        before, after = np.floor(ticks), np.ceil(ticks)
        share = (ticks - before)[:, None, None]
        there = vertices(chosen).astype(np.float64)
        around = [vertices(missed.first + k / missed.rate) for k in (before, after)]
        shown = (1 - share) * around[0] + share * around[1]
        distance = np.linalg.norm(there - shown, axis=2).max()
        diagonal = np.linalg.norm(np.ptp(there, axis=1), axis=1).max()
        tell(missed.path, self.clip, len(missed.times), distance, diagonal, own=missed.own)


def tell(
    path: Path, clip: Clip, count: int, distance: float, diagonal: float, *, own: bool
) -> None:
    """Warn, or log if not `own`, that `count` keys of a clip lie between its frames.

    `distance` is the largest error of a vertex that results.
    """
    if not distance > _LEAST * diagonal:
        return
    share = f" ({100 * distance / diagonal:.2g} % of the diagonal)" if diagonal else ""
    text = (
        f"{path}: {count} keys of the clip {clip.name} lie between its frames, which are "
        f"{clip.fps:g} a second: vertices are up to {distance:.3g}{share} from where the file has "
        "them (fps= or --read fps= samples at another rate)"
    )
    if own:
        warnings.warn(text, SsdrWarning, stacklevel=2)
    else:
        _log.info(text)
