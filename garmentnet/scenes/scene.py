"""Descriptions of data sets and of the scenes, one for each clip, that they consist of.

A :class:`DataSet` is one garment on one body with any number of motions and parameter sets.  It
expands to one :class:`Scene` for each clip, in a fixed order and with fixed names.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

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

__all__ = ["DataSet", "MeshGarment", "MotionSource", "ParameterSet", "Scene", "check_integers"]

# Suffix of the name of a perturbed clip.
_PERTURBED = "-moved"


def check_integers(values: Any, positive: Sequence[str] = ()) -> None:
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
        check_integers(self, positive=("frames",))

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
class ParameterSet:
    """Simulation parameters and their split for the ensemble.

    Parameters
    ----------
    name : str
    split : {"train", "validation", "test"}
        Split of the parameter set; networks are trained only on "train".
    parameters : SimulationParameters
    """

    name: str
    split: Split
    parameters: SimulationParameters


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
    """Description of a data set: clips of one garment on one body.

    Attributes
    ----------
    name : str
    fps : float
    seed : int
    garment : Cut or MeshGarment
    body : str
        Path of a body file; empty: the one that ships.
    solver : Solver
    gate : Gate
    base : ParameterSet
        Parameter set with which every motion is simulated.
    motions : tuple of MotionSource
    sets : tuple of ParameterSet
        Further parameter sets.
    set_motions : tuple of tuple of MotionSource
        Motions that are simulated with each of `sets`.
    perturbation : float
        RMS displacement, metres, of the perturbed start from which test clips are simulated a
        second time; with 0 they are not.
    perturb_sets : bool
        Whether this is done for test clips of `sets`, too.

    Examples
    --------
    >>> from garmentnet.scenes.scene_file import load_data_set
    >>> tiny = load_data_set("tiny")
    >>> tiny.scenes()[0].name
    'base-dance-0000'
    """

    name: str
    fps: float
    seed: int
    garment: Cut | MeshGarment
    body: str
    solver: Solver
    gate: Gate
    base: ParameterSet
    motions: tuple[MotionSource, ...]
    sets: tuple[ParameterSet, ...] = ()
    set_motions: tuple[tuple[MotionSource, ...], ...] = ()
    perturbation: float = 0.0
    perturb_sets: bool = True

    def scenes(self) -> tuple[Scene, ...]:
        """One scene for each clip: base parameters, their perturbed test clips, other sets."""
        scenes = self._with_pairs([self._scene(self.base, m) for m in self.motions])
        for parameters, motions in zip(self.sets, self.set_motions, strict=True):
            further = [self._scene(parameters, m) for m in motions]
            scenes += self._with_pairs(further) if self.perturb_sets else further
        return tuple(scenes)

    def with_motions(self, motions: tuple[MotionSource, ...]) -> DataSet:
        """A copy with further motions under the base parameters."""
        return dataclasses.replace(self, motions=self.motions + motions)

    def make_body(self) -> Body:
        return load_body(self.body) if self.body else default_body()

    def make_garment(self, body: Body) -> Garment:
        if isinstance(self.garment, Cut):
            return cut_garment(body, self.garment)
        return garment_from_mesh(body, self.garment.mesh, pinned_above=self.garment.pinned_above)

    def _scene(self, parameters: ParameterSet, motion: MotionSource) -> Scene:
        return Scene(f"{parameters.name}-{motion.name}", self, motion, parameters)

    def _with_pairs(self, scenes: list[Scene]) -> list[Scene]:
        """The scenes, followed by perturbed copies of those with test motions."""
        tests = [s for s in scenes if self.perturbation and s.motion.split == "test"]
        return scenes + [self._perturbed(s) for s in tests]

    def _perturbed(self, scene: Scene) -> Scene:
        return dataclasses.replace(
            scene,
            name=scene.name + _PERTURBED,
            perturbation=self.perturbation,
            repeat_of=scene.name,
        )
