"""The clips of an animation: which frames belong together, and how fast they play."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from ..common.checks import check_whole
from ..common.errors import InputError, is_real, is_whole
from .surface import common_space

if TYPE_CHECKING:
    from .sequence import MeshSequence


@dataclasses.dataclass(frozen=True)
class Clip:
    """A range of frames that plays as one animation.

    Parameters
    ----------
    name : str
    start, stop : int
        Index of the first frame, and of the frame after the last.
    fps : float
        Frames per second.

    Raises
    ------
    InputError
        If the range is empty or the frame rate is not positive.

    Examples
    --------
    >>> walk = ssdr.Clip("walk", 0, 25, 24.0)
    >>> walk.n_frames, walk.frames
    (25, slice(0, 25, None))
    """

    name: str
    start: int
    stop: int
    fps: float = 24.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        if not isinstance(self.name, str) or readable(self.name) != self.name:
            raise InputError("clip.name", "a text that a file can hold", repr(self.name))
        if not (is_whole(self.start) and is_whole(self.stop) and 0 <= self.start < self.stop):
            raise InputError(
                "clip", "frames from start >= 0 up to a later stop", f"{self.start} to {self.stop}"
            )
        if not (is_real(self.fps) and self.fps > 0):
            raise InputError("clip.fps", "a positive number", repr(self.fps))
        put(self, "start", int(self.start))
        put(self, "stop", int(self.stop))
        put(self, "fps", float(self.fps))

    @property
    def n_frames(self) -> int:
        return self.stop - self.start

    @property
    def frames(self) -> slice:
        """The frames as an index: ``model.skin(clip.frames)``."""
        return slice(self.start, self.stop)

    def part(self, first: float, last: float) -> Clip:
        """The clip from frame `first` to `last`, both included and counted from 0 at its start.

        Raises
        ------
        InputError
            If it has none of these frames.
        """
        start = self.start + max(0, math.ceil(first))
        stop = min(self.stop, self.start + math.floor(last) + 1)
        if not start < stop:
            held = f"some of the frames 0 to {self.n_frames - 1}"
            raise InputError("frames", held, f"{first:g} to {last:g}")
        return dataclasses.replace(self, start=start, stop=stop)


class OneClip(tuple[Clip, ...]):
    """Tuple of the only clip of a model, with all frames and the frame rate of the model.

    ``dataclasses.replace(model, fps=30)`` passes the old clip together with the new rate.  This
    type marks a clip that then takes the new rate; a clip given by the caller must agree with it.
    """

    __slots__ = ()


def check_clips(
    clips: Any, *, fps: Any, name: str, n_frames: int
) -> tuple[tuple[Clip, ...], float]:
    """Check the clips of a model; return them and the frame rate, which is that of the first clip.

    Raises
    ------
    InputError
        If the clips are not consecutive ranges that cover all frames, two have the same name, or
        `fps` is not the rate of the first.
    """
    if fps is not None and not (is_real(fps) and fps > 0):
        raise InputError("fps", "a positive number", repr(fps))
    if clips is None or isinstance(clips, OneClip):
        old = clips[0] if clips else Clip(readable(name), 0, n_frames)
        rate = old.fps if fps is None else float(fps)
        return OneClip((Clip(old.name, 0, n_frames, rate),)), rate
    listed = tuple(clips) if isinstance(clips, Iterable) else (clips,)
    for k, clip in enumerate(listed):
        if not isinstance(clip, Clip):
            raise InputError(f"clips[{k}]", "a Clip", type(clip).__name__)
        first = listed[k - 1].stop if k else 0
        if clip.start != first:
            raise InputError(
                f"clips[{k}]", f"the frames from {first} on", f"{clip.start} to {clip.stop}"
            )
        if len(listed) > 1 and (not clip.name or clip.name in (c.name for c in listed[:k])):
            raise InputError(f"clips[{k}]", "a name that no other clip has", repr(clip.name))
    stop = listed[-1].stop if listed else 0
    if stop != n_frames:
        raise InputError("clips", f"ranges that cover the {n_frames} frames", f"{stop} frames")
    if fps is not None and fps != listed[0].fps:
        raise InputError(
            "fps", f"{listed[0].fps:g}, as of the first clip (clips say their own rates)", fps
        )
    return (OneClip(listed) if len(listed) == 1 else listed), listed[0].fps


def in_order(clips: Iterable[Clip]) -> tuple[Clip, ...]:
    """The clips, moved to consecutive ranges from frame 0 on."""
    result: list[Clip] = []
    for clip in clips:
        first = result[-1].stop if result else 0
        result.append(dataclasses.replace(clip, start=first, stop=first + clip.n_frames))
    return tuple(result)


def one_rate(clips: Sequence[Clip]) -> bool:
    """Whether all clips have the same frame rate."""
    return len({clip.fps for clip in clips}) == 1


def names_of(sequences: Sequence[MeshSequence]) -> dict[str, Any]:
    """Keyword arguments for a model of several sequences: name, frame rate, clips and space.

    Each sequence becomes a clip, named by the sequence's `clip` or, if that is empty, its `name`.
    The model has the name of the sequences if all have the same, and no name otherwise.
    """
    several = len(sequences) > 1
    names = [s.clip or s.name or (f"clip_{k}" if several else "") for k, s in enumerate(sequences)]
    clips = in_order(
        Clip(readable(name), 0, len(s), s.fps)
        for name, s in zip(unique_names(names) if several else names, sequences, strict=True)
    )
    same = len({s.name for s in sequences}) == 1
    name, space = sequences[0].name if same else "", common_space(s.space for s in sequences)
    return {"name": name, "fps": clips[0].fps, "clips": clips, "space": space}


def pick(names: Sequence[str], clip: Any) -> int:
    """Index of the clip with this name or index.  None stands for the first clip.

    Raises
    ------
    InputError
        If there is no such clip.
    """
    if clip is None:
        return 0
    if isinstance(clip, str) and clip in names:
        return list(names).index(clip)
    if not is_whole(clip):
        raise InputError("clip", f"one of {list(names)}", repr(clip))
    return check_whole(clip, "clip", 0, len(names) - 1)


def readable(name: object) -> str:
    """A name as text that any file can hold.

    NUL is removed, and each lone surrogate becomes a question mark.
    """
    return str(name).replace("\0", "").encode("utf-8", "replace").decode()


def unique_names(names: Sequence[str], default: str = "bone") -> tuple[str, ...]:
    """Distinct names: a repeated name gets a numeric suffix, and an empty one is `default`."""
    seen: set[str] = set()
    numbers: dict[str, int] = {}  # next suffix of each name; all smaller ones are taken
    result = []
    for name in names:
        base = name or default
        name = base
        while name in seen:
            number = numbers.get(base, 1)
            name, numbers[base] = f"{base}_{number}", number + 1
        seen.add(name)
        result.append(name)
    return tuple(result)
