"""Descriptions of data sets and of the scenes, one for each clip, that they consist of.

A :class:`DataSet` is one garment on one body with any number of motions and parameter sets.  It
expands to one :class:`Scene` for each clip, in a fixed order and with fixed names.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

from ssdr.errors import InputError

from ..data.bvh import read_bvh
from ..data.clip_files import Split
from ..data.motion import Motion
from ..data.parameters import SimulationParameters
from ..data.retarget import retarget
from .body import Body, default_body, load_body
from .cloth import Solver
from .cut import Cut, cut_garment
from .dance.choreography import DANCE_CLASSES, Repertoire, dance
from .garments import Garment, garment_from_mesh
from .quality import Gate
from .simulator import VERSION

__all__ = [
    "Dances",
    "DancesOfSplits",
    "DataSet",
    "MeshGarment",
    "MotionSource",
    "ParameterSet",
    "Scene",
]

SPLITS: tuple[Split, ...] = get_args(Split)
# Distance between the first seeds of the splits, and of the further parameter sets after them, so
# that one can grow without changing the others.
_SEEDS_OF_A_SPLIT = 1000
# Suffix of the name of a perturbed clip.
_PERTURBED = "-moved"


def _check_integers(values: Any, positive: Sequence[str] = ()) -> None:
    """Raise an InputError for a negative integer of a dataclass, or a 0 if named in `positive`."""
    for field in dataclasses.fields(values):
        value, least = getattr(values, field.name), int(field.name in positive)
        if field.type == "int" and value < least:
            raise InputError(field.name, f"an integer >= {least}", value)


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
    whole : int
        Number of frames to generate, of which the first `frames` are used; 0 stands for `frames`.
        It matters because a shorter dance is not the beginning of a longer one.
    repertoire : {"basic", "wide"}
        Repertoire of the generator.

    Raises
    ------
    InputError
        If a number or a class is not usable.

    Examples
    --------
    >>> spin = MotionSource("spin", "train", seed=1, frames=20, classes=("spin",))
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
    whole: int = 0
    repertoire: Repertoire = "basic"

    def __post_init__(self) -> None:
        for c in self.classes:
            if c not in DANCE_CLASSES:
                raise InputError("classes", f"some of {', '.join(DANCE_CLASSES)}", c)
        _check_integers(self, positive=("frames",))

    def make(self, body: Body, fps: float) -> Motion:
        """Generate or read the motion."""
        if self.file:
            whole = retarget(read_bvh(self.file), body.skeleton, fps=fps)
            stop = min(whole.n_frames, self.start + self.frames)
            return whole.cut(self.start, stop)
        danced = dance(
            body.skeleton,
            seed=self.seed,
            frames=max(self.frames, self.whole),
            fps=fps,
            classes=self.classes or None,
            repertoire=self.repertoire,
        )
        return danced.cut(0, self.frames)


@dataclasses.dataclass(frozen=True)
class Dances:
    """Dances of the generator whose seeds follow each other.

    Parameters
    ----------
    name : str
        A dance has this name and its seed.
    split : {"train", "validation", "test"}
    count, frames : int
        Number of dances, and the length of each.
    seed : int
        Seed of the first.
    repertoire : {"basic", "wide"}
    """

    name: str
    split: Split = "test"
    count: int = 1
    frames: int = 300
    seed: int = 0
    repertoire: Repertoire = "basic"

    def __post_init__(self) -> None:
        _check_integers(self, positive=("frames",))
        if not self.name.isidentifier():
            raise InputError("name", "letters, digits and _", self.name)

    def sources(self) -> list[MotionSource]:
        """One source for each dance."""
        split, frames, repertoire = self.split, self.frames, self.repertoire
        return [
            MotionSource(f"{self.name}-{seed:04d}", split, seed, frames, repertoire=repertoire)
            for seed in range(self.seed, self.seed + self.count)
        ]


@dataclasses.dataclass(frozen=True)
class DancesOfSplits:
    """Dances for all splits, and those that further parameter sets repeat.

    Parameters
    ----------
    train, validation, test : int
        Numbers of dances under the base parameters.
    frames : int
    seed : int
    repertoire : {"basic", "wide"}
    train_frames : int
        Frames of a training dance, which may be longer, since settling takes as long for a short
        one; 0 stands for `frames`.
    set_train, set_validation, set_test : int
        Numbers of the base's dances in each split that a further parameter set repeats.
    set_frames : int
        How many frames of each; 0: all.
    set_own : int
        Number of dances that a further training set has for itself, instead of the base's first.
    """

    train: int
    validation: int = 0
    test: int = 0
    frames: int = 300
    seed: int = 0
    repertoire: Repertoire = "basic"
    train_frames: int = 0
    set_train: int = 0
    set_validation: int = 0
    set_test: int = 0
    set_frames: int = 0
    set_own: int = 0

    def __post_init__(self) -> None:
        _check_integers(self, positive=("train", "frames"))
        for split in SPLITS:
            count, most = getattr(self, f"set_{split}"), getattr(self, split)
            if count > most:
                raise InputError(f"set_{split}", f"at most {most}, as {split}", count)


@dataclasses.dataclass(frozen=True)
class ParameterSet(SimulationParameters):
    """Simulation parameters with a name, and their split for the ensemble.

    Parameters
    ----------
    bending, density, time_scale : float
    name : str
    split : {"train", "validation", "test"}
        Split of the parameter set; networks are trained only on "train".
    """

    name: str = ""
    split: Split = "train"

    @property
    def parameters(self) -> SimulationParameters:
        """The numbers alone."""
        return SimulationParameters(self.bending, self.density, self.time_scale)


@dataclasses.dataclass(frozen=True)
class Scene:
    """Description of one clip: a garment on a body, a motion, and parameters.

    Attributes
    ----------
    name : str
        Name of the clip in its store.
    data_set : DataSet
        Garment, body, solver and gate.
    motion : MotionSource
    parameters : ParameterSet
    perturbation : float
        RMS displacement of the settled garment before the first frame, metres.
    repeat_of : str
        For a perturbed clip, the name of the same clip without perturbation.
    """

    name: str
    data_set: DataSet
    motion: MotionSource
    parameters: ParameterSet
    perturbation: float = 0.0
    repeat_of: str = ""

    @property
    def seed(self) -> int:
        return self.data_set.seed + self.motion.seed

    def provenance(self) -> dict[str, Any]:
        """Plain JSON with everything from which the clip can be simulated again."""
        motion = dataclasses.asdict(self.motion)
        # Only the file's name: with its path, the stored bytes would depend on the machine.
        motion["file"] = Path(self.motion.file).name
        return {
            "data_set": self.data_set.name,
            # Fields that have no effect are left out, so that older stores are still recognised.
            "garment": {k: v for k, v in dataclasses.asdict(self.data_set.garment).items() if v},
            "solver": dataclasses.asdict(self.data_set.solver),
            "motion": motion,
            "parameter_set": self.parameters.name,
            "parameter_split": self.parameters.split,
            "repeat_of": self.repeat_of,
            "simulator": VERSION,
        }


@dataclasses.dataclass(frozen=True)
class MeshGarment:
    """A garment from a mesh file.

    Parameters
    ----------
    mesh : str
        Path of the mesh; if it stands in a scene file, relative to that file.
    pinned_above : float
        Height in metres; vertices at or above it follow the body.
    """

    mesh: str
    pinned_above: float


@dataclasses.dataclass(frozen=True)
class DataSet:
    """Description of a data set: clips of one garment on one body; what a scene file may hold.

    Parameters
    ----------
    name : str
    fps : float
    seed : int
        Added to the seeds of all motions.
    perturbation : float
        RMS displacement, metres, of the perturbed start from which test clips are simulated a
        second time; with 0 they are not.
    perturb_sets : bool
        Whether this is done for test clips of the further parameter sets, too.
    garment : Cut or MeshGarment
    body : str
        Path of a body file; empty: the one that ships.
    solver : Solver
    gate : Gate
    base : SimulationParameters
        Parameters with which every motion is simulated.
    motions : DancesOfSplits, optional
    motion : MotionSource, optional
        A single motion, instead of `motions`.
    further : tuple of Dances
        More dances under the base parameters.
    set : tuple of ParameterSet
        Further parameter sets.

    Raises
    ------
    InputError
        If a number is out of its range or there are no motions.

    Examples
    --------
    >>> from garmentnet.scenes.scene_file import load_data_set
    >>> tiny = load_data_set("tiny")
    >>> tiny.scenes()[0].name
    'base-dance-0000'
    """

    name: str = ""
    fps: float = 30.0
    seed: int = 0
    perturbation: float = 0.0
    perturb_sets: bool = True
    garment: Cut | MeshGarment = dataclasses.field(default_factory=Cut)
    body: str = ""
    solver: Solver = dataclasses.field(default_factory=Solver)
    gate: Gate = dataclasses.field(default_factory=Gate)
    base: SimulationParameters = dataclasses.field(default_factory=SimulationParameters)
    motions: DancesOfSplits | None = None
    motion: MotionSource | None = None
    further: tuple[Dances, ...] = ()
    set: tuple[ParameterSet, ...] = ()

    def __post_init__(self) -> None:
        if not 1 <= self.fps <= 120:
            raise InputError("fps", "1 to 120", self.fps)
        if not 0 <= self.perturbation <= 0.1:
            raise InputError("perturbation", "0 to 0.1", self.perturbation)
        _check_integers(self)
        if (self.motions is None) == (self.motion is None):
            raise InputError("motion, motions", "one of the two", "both" if self.motion else "none")
        if "dance" in [group.name for group in self.further]:
            raise InputError("further", 'another name than that of [motions], "dance"', "dance")

    @property
    def sets(self) -> tuple[ParameterSet, ...]:
        """The parameter sets, the base first, each with its name."""
        named = (
            dataclasses.replace(s, name=s.name or f"set{k:02d}") for k, s in enumerate(self.set, 1)
        )
        return (ParameterSet(**dataclasses.asdict(self.base), name="base"), *named)

    @functools.cached_property
    def sources(self) -> tuple[tuple[MotionSource, ...], ...]:
        """Motions of each of the `sets`."""
        further = [m for group in self.further for m in group.sources()]
        table = self.motions
        if table is None:
            assert self.motion is not None
            one = self.motion
            stem = Path(one.file).name.split(".")[0] if one.file else f"dance-{one.seed:04d}"
            named = dataclasses.replace(one, name=one.name or stem)
            return ((named, *further), *(() for _ in self.set))
        base = {s: self._dances(table, k, s, getattr(table, s)) for k, s in enumerate(SPLITS)}
        found = [tuple(m for dances in (*base.values(), further) for m in dances)]
        most = table.set_frames or max(table.frames, table.train_frames)
        for k, parameters in enumerate(self.set, start=len(SPLITS)):
            some = {split: base[split][: getattr(table, f"set_{split}")] for split in SPLITS}
            if table.set_own and parameters.split == "train":
                some["train"] = self._dances(table, k, "train", table.set_own)
            found.append(
                tuple(
                    dataclasses.replace(m, frames=most, whole=m.frames) if m.frames > most else m
                    for dances in some.values()
                    for m in dances
                )
            )
        return tuple(found)

    def _dances(
        self, table: DancesOfSplits, block: int, split: Split, count: int
    ) -> list[MotionSource]:
        frames = (split == "train" and table.train_frames) or table.frames
        first = table.seed + self.seed + _SEEDS_OF_A_SPLIT * block
        return Dances("dance", split, count, frames, first, table.repertoire).sources()

    def scenes(self, recorded: Sequence[MotionSource] = ()) -> tuple[Scene, ...]:
        """One scene for each clip: base parameters, their perturbed test clips, other sets.

        `recorded` are further motions under the base parameters.
        """
        scenes: list[Scene] = []
        for k, (parameters, sources) in enumerate(zip(self.sets, self.sources, strict=True)):
            motions = sources if k else (*sources, *recorded)
            plain = [Scene(f"{parameters.name}-{m.name}", self, m, parameters) for m in motions]
            scenes += plain
            if self.perturbation and (k == 0 or self.perturb_sets):
                scenes += [
                    dataclasses.replace(
                        scene,
                        name=scene.name + _PERTURBED,
                        perturbation=self.perturbation,
                        repeat_of=scene.name,
                    )
                    for scene in plain
                    if scene.motion.split == "test"
                ]
        return tuple(scenes)

    def make_body(self) -> Body:
        return load_body(self.body) if self.body else default_body()

    def make_garment(self, body: Body) -> Garment:
        if isinstance(self.garment, Cut):
            return cut_garment(body, self.garment)
        return garment_from_mesh(body, self.garment.mesh, pinned_above=self.garment.pinned_above)
