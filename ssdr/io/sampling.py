"""Clips of a scene, sampled at their frames, and the error of vertices at keys between these."""

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
from .frame_rates import Frames, Times

_log = logging.getLogger(__name__)
_MOST_LOOKS, _MOST_BYTES = 256, 64 << 20  # limits of the key times at which vertices are compared
_LEAST = 1e-6  # of the diagonal: rounding of float32 vertices


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Sample:
    """One clip of a scene, with the parts to show in it.

    Attributes
    ----------
    clip : Clip
    parts : sequence of ScenePart
        The same parts in every clip of a file.
    time : object
        Frames of the clip, in the form that the parts of this file format take.
    at : callable
        Function from n times to that form.
    frames : Frames
        Frames of the clip, in the file's unit of time.
    path : Path
    own : bool
        Whether the reader chose the frame rate, since the caller gave none.
    """

    clip: Clip
    parts: Sequence[Any]
    time: Any
    at: Callable[[Times], Any]
    frames: Frames
    path: Path
    own: bool

    def tell_missed(self, vertices_of: Callable[..., NDArray[np.floating]]) -> None:
        """Warn of keys between frames, with the largest error of vertices at these keys.

        The error is the distance between the vertices at a key and those interpolated linearly
        between the two frames around it, as players do. At most 256 keys are compared.

        Parameters
        ----------
        vertices_of : callable
            The function :func:`ssdr.io.scene.vertices_of`.
        """
        frames, width = self.frames, sum(len(part.indices) for part in self.parts)
        missed = frames.missed
        if not len(missed) or not (self.own or _log.isEnabledFor(logging.INFO)):
            return

        def vertices(times: Times) -> NDArray[np.floating]:
            return vertices_of(self.parts, self.at(times), len(times))

        looks = min(len(missed), _MOST_LOOKS, max(1, _MOST_BYTES // (12 * width)))
        chosen = missed[np.linspace(0, len(missed) - 1, looks).astype(int)]
        ticks = np.clip((chosen - frames.first) * frames.rate, 0, frames.count - 1)
        before, after = np.floor(ticks), np.ceil(ticks)
        share = (ticks - before)[:, None, None]
        there = vertices(chosen).astype(np.float64)
        around = [vertices(frames.first + k / frames.rate) for k in (before, after)]
        shown = (1 - share) * around[0] + share * around[1]
        distance = np.linalg.norm(there - shown, axis=2).max()
        diagonal = np.linalg.norm(np.ptp(there, axis=1), axis=1).max()
        tell(self.path, self.clip, len(missed), distance, diagonal, own=self.own)


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
        "them (fps= samples at another rate)"
    )
    if own:
        warnings.warn(text, SsdrWarning, stacklevel=2)
    else:
        _log.info(text)
