"""Clips of a scene, sampled at their frames, and the error of vertices at keys between these."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.errors import SsdrWarning
from ..mesh.clips import Clip
from ..model.lbs import skin
from .frame_rates import Frames, Times
from .save_report import frame_blocks

_MOST_LOOKS, _MOST_BYTES = 256, 64 << 20  # limits of the key times at which vertices are compared
_LEAST = 1e-6  # of the diagonal: rounding of float32 vertices
_MOST_NAMES = 8  # in a warning


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
    """

    clip: Clip
    parts: Sequence[Any]
    time: Any
    at: Callable[[Times], Any]
    frames: Frames

    def hidden(self, path: Path, vanish: bool) -> list[tuple[slice, NDArray[np.bool_]]]:
        """Vertices that the file `path` hides in some frames, and the mask (F,) of these frames.

        A warning names the meshes and the frames' own numbers, unless they are to `vanish`.
        """
        starts = part_starts(self.parts)
        found: list[tuple[slice, NDArray[np.bool_]]] = []
        said: dict[str, list[str]] = {}
        for part, start, stop in zip(self.parts, starts[:-1], starts[1:], strict=True):
            hidden = ~part.shown(self.time)
            if hidden.any():
                found.append((slice(start, stop), hidden))
                said.setdefault(_ranges(self.frames.numbers, hidden), []).append(part.name)
        for frames, names in said.items() if not vanish else ():
            listed = ", ".join(names[:_MOST_NAMES]) + " and others" * (len(names) > _MOST_NAMES)
            text = f"{listed}: hidden in frames {frames} of the clip {self.clip.name}, shown here"
            hint = "vanish= shrinks what is hidden to a point"
            warnings.warn(f"{path}: {text} ({hint})", SsdrWarning, stacklevel=2)
        return found

    def tell_missed(self, path: Path) -> None:
        """Warn of keys between frames, with the largest error of vertices at these keys.

        The error is the distance between the vertices at a key and those interpolated linearly
        between the two frames around it, as players do. At most 256 keys are compared.
        """
        frames, clip, missed = self.frames, self.clip, self.frames.missed
        width = int(part_starts(self.parts)[-1])
        if not len(missed):
            return

        def vertices(times: Times) -> NDArray[np.floating]:
            return vertices_of(self.parts, self.at(times), len(times))

        looks = min(len(missed), _MOST_LOOKS, max(1, _MOST_BYTES // (12 * width)))
        chosen = missed[np.linspace(0, len(missed) - 1, looks).astype(int)]
        ticks = np.clip((chosen - frames.first) * frames.rate, 0, frames.count - 1)
        before, after = np.floor(ticks), np.ceil(ticks)
        part = (ticks - before)[:, None, None]
        there = vertices(chosen).astype(np.float64)
        around = [vertices(frames.first + k / frames.rate) for k in (before, after)]
        shown = (1 - part) * around[0] + part * around[1]
        distance = np.linalg.norm(there - shown, axis=2).max()
        diagonal = np.linalg.norm(np.ptp(there, axis=1), axis=1).max()
        if not distance > _LEAST * diagonal:
            return
        share = f" ({100 * distance / diagonal:.2g} % of the diagonal)" if diagonal else ""
        text = (
            f"{path}: {len(missed)} keys of the clip {clip.name} lie between its frames, which are "
            f"{clip.fps:g} a second: vertices are up to {distance:.3g}{share} from where the file "
            "has them (fps= samples at another rate)"
        )
        warnings.warn(text, SsdrWarning, stacklevel=2)


def part_starts(parts: Sequence[Any]) -> NDArray[np.int64]:
    """Index of each part's first vertex in the joined vertices, then the number of all vertices."""
    return np.cumsum([0, *(len(part.indices) for part in parts)])


def vertices_of(parts: Sequence[Any], time: Any, n_frames: int) -> NDArray[np.float32]:
    """Skinned vertices (F, V, 3) of all parts at the `n_frames` frames of `time`."""
    starts = part_starts(parts)
    frames = np.empty((n_frames, starts[-1], 3), dtype=np.float32)
    for part, start in zip(parts, starts[:-1], strict=True):
        shape, moved = part.shape(time), part.transforms(time)
        out = frames[:, start : start + len(part.indices)]
        blocks = frame_blocks(0, n_frames, out.shape[1])
        if callable(shape):
            blocks = (slice(k, k + 1) for k in range(n_frames))
        for block in blocks:
            rest = shape(block.start) if callable(shape) else shape
            out[block] = skin(rest, part.indices, part.weights, moved[block], dtype=np.float64)
    return frames


def _ranges(numbers: Times, mask: NDArray[np.bool_]) -> str:
    """Text on the runs of frames in a mask (F,), such as "1 to 12, 30 to 32"."""
    index = np.flatnonzero(mask)
    runs = np.split(index, np.flatnonzero(np.diff(index) > 1) + 1)
    return ", ".join(f"{numbers[run[0]]:g} to {numbers[run[-1]]:g}" for run in runs)
