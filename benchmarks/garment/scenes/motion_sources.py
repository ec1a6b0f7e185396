"""Where the motions of a data set come from: the generator of dances, or BVH files."""

from __future__ import annotations

import dataclasses
import math
from typing import get_args

from garmentnet.data.clip_files import Split
from ssdr.common.checks import LARGEST
from ssdr.common.errors import InputError

from .body import Body
from .bvh import read_bvh
from .dance.choreography import DANCE_CLASSES, dance
from .limits import check_numbers
from .motion import Motion
from .retarget import retarget

SPLITS: tuple[Split, ...] = get_args(Split)
_SEEDS_OF_A_SPLIT = 1000
_FROM_1 = (1, LARGEST)


@dataclasses.dataclass(frozen=True)
class MotionSource:
    """Source of a motion: the generator of dances or a BVH file.

    Parameters
    ----------
    name : str
        Name of the motion, which all clips with this motion share.
    split : {"train", "validation", "test"}
    seed : int
        Seed of the generator.
    frames : int
    classes : tuple of str
        Classes of motion for the generator; empty: drawn from the seed.
    file : str
        A BVH file, used instead of the generator.
    start : int
        First frame of the file, at the scene's frame rate.

    Raises
    ------
    InputError
        If a number or a class is not usable.

    Examples
    --------
    >>> spin = MotionSource("spin", "train", seed=1, frames=20, classes=("spin",))
    >>> from benchmarks.garment.scenes.body import default_body
    >>> spin.make(default_body(), fps=30.0).n_frames
    20
    """

    name: str = ""
    split: Split = "train"
    seed: int = 0
    frames: int = 300
    classes: tuple[str, ...] = ()
    file: str = ""
    start: int = 0

    def __post_init__(self) -> None:
        for c in self.classes:
            if c not in DANCE_CLASSES:
                raise InputError("classes", f"some of {', '.join(DANCE_CLASSES)}", c)
        check_numbers(self, frames=_FROM_1)

    def make(self, body: Body, fps: float) -> Motion:
        """Generate or read the motion."""
        if self.file:
            whole = retarget(read_bvh(self.file), body.skeleton, fps=fps)
            stop = min(whole.n_frames, self.start + self.frames)
            return whole.cut(self.start, stop)
        return dance(
            body.skeleton,
            seed=self.seed,
            frames=self.frames,
            fps=fps,
            classes=self.classes or None,
        )


@dataclasses.dataclass(frozen=True)
class Dances:
    """Generated dances with consecutive seeds.

    Parameters
    ----------
    name : str
        A dance has this name and its seed.
    split : {"train", "validation", "test"}
    count, frames : int
        Number of dances, and the length of each.
    seed : int
        Seed of the first.
    """

    name: str
    split: Split = "test"
    count: int = 1
    frames: int = 300
    seed: int = 0

    def __post_init__(self) -> None:
        check_numbers(self, frames=_FROM_1)
        if not self.name.isidentifier():
            raise InputError("name", "letters, digits and _", self.name)

    def sources(self) -> list[MotionSource]:
        """One source for each dance."""
        return [
            MotionSource(f"{self.name}-{seed:04d}", self.split, seed, self.frames)
            for seed in range(self.seed, self.seed + self.count)
        ]


@dataclasses.dataclass(frozen=True)
class DancesOfSplits:
    """Numbers of dances in each split, and of those that every further parameter set repeats.

    Parameters
    ----------
    train, validation, test : int
        Numbers of dances under the base parameters.
    frames : int
    seed : int
    train_frames : int
        Frames of a training dance, which may be longer, since settling takes as long for a short
        one; 0 stands for `frames`.
    set_train, set_validation, set_test : int
        Numbers of the base's dances in each split that a further parameter set repeats.
    """

    train: int
    validation: int = 0
    test: int = 0
    frames: int = 300
    seed: int = 0
    train_frames: int = 0
    set_train: int = 0
    set_validation: int = 0
    set_test: int = 0

    def __post_init__(self) -> None:
        check_numbers(self, train=(1, _SEEDS_OF_A_SPLIT), frames=_FROM_1)
        for split in SPLITS:
            count, most = getattr(self, f"set_{split}"), getattr(self, split)
            if count > most:
                raise InputError(f"set_{split}", f"at most {most}, as {split}", count)

    def share(self, part: float) -> DancesOfSplits:
        """A share of the dances: the first of every split, their numbers rounded up."""
        names = (prefix + split for split in SPLITS for prefix in ("", "set_"))
        return dataclasses.replace(self, **{n: math.ceil(part * getattr(self, n)) for n in names})

    def sources(self, split: Split, seed: int) -> list[MotionSource]:
        """One source for each dance of a split.

        Each split has a thousand seeds of its own, so that one can grow without changing the
        others.
        """
        frames = (split == "train" and self.train_frames) or self.frames
        first = self.seed + seed + _SEEDS_OF_A_SPLIT * SPLITS.index(split)
        count = getattr(self, split)
        return Dances("dance", split, count, frames, first).sources()
