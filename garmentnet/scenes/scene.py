"""What a clip is made of, as a small typed description.

A :class:`DataSet` is one garment on one body with any number of motions and parameter sets; it
expands to :class:`Scene`\\ s, one a clip, in a fixed order and with fixed names.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..data.bvh import read_bvh
from ..data.clip_files import Split
from ..data.motion import Motion
from ..data.parameters import SimulationParameters
from ..data.retarget import retarget
from .body import Body, default_body, load_body
from .cloth import Solver
from .dance.choreography import dance
from .garments import Dress, Garment, cut_dress, garment_from_mesh
from .quality import Gate

__all__ = ["DataSet", "MeshGarment", "MotionSource", "ParameterSet", "Scene"]

_MOVED = "-moved"


@dataclasses.dataclass(frozen=True)
class MotionSource:
    """Where a motion comes from.

    Parameters
    ----------
    name : str
        The same for every clip of this motion.
    split : {"train", "validation", "test"}
    seed : int
        Of the generator.
    frames : int
    classes : tuple of str
        Moves of the generator; none: drawn from the seed.
    file : str
        A BVH file instead of the generator.
    start : int
        First frame of the file, at the scene's rate.
    whole : int
        Frames that the generator makes, of which the first `frames` are used; 0: as many.  A
        dance that is shorter is another dance, not the beginning of a longer one.
    """

    name: str
    split: Split
    seed: int
    frames: int
    classes: tuple[str, ...] = ()
    file: str = ""
    start: int = 0
    whole: int = 0

    def make(self, body: Body, fps: float) -> Motion:
        """The motion itself."""
        if self.file:
            whole = retarget(read_bvh(self.file), body.skeleton, fps=fps)
            stop = min(whole.n_frames, self.start + self.frames)
            return whole.cut(self.start, stop, self.name)
        danced = dance(
            body.skeleton,
            seed=self.seed,
            frames=max(self.frames, self.whole),
            fps=fps,
            classes=self.classes or None,
            name=self.name,
        )
        return danced.cut(0, self.frames)


@dataclasses.dataclass(frozen=True)
class ParameterSet:
    """Simulation parameters and the part they play for the ensemble.

    Parameters
    ----------
    name : str
    split : {"train", "validation", "test"}
        Whether networks may learn from it.
    parameters : SimulationParameters
    """

    name: str
    split: Split
    parameters: SimulationParameters


@dataclasses.dataclass(frozen=True)
class Scene:
    """One clip: a garment on a body, a motion, parameters.

    Attributes
    ----------
    name : str
        Of the clip in its store.
    data_set : DataSet
        Garment, body, solver and gate.
    motion : MotionSource
    parameters : ParameterSet
    perturbation : float
        Metres by which the settled garment is moved before the first frame.
    repeat_of : str
        The clip that this one repeats, for a perturbed one.
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

    def provenance(self, versions: Mapping[str, str]) -> dict[str, Any]:
        """All that it takes to make the clip again."""
        motion = dataclasses.asdict(self.motion)
        # Where the file lay does not matter; a path would tie the bytes to one machine.
        motion["file"] = Path(self.motion.file).name
        return {
            "data_set": self.data_set.name,
            "garment": dataclasses.asdict(self.data_set.garment),
            "solver": dataclasses.asdict(self.data_set.solver),
            "motion": motion,
            "parameter_set": self.parameters.name,
            "parameter_split": self.parameters.split,
            "repeat_of": self.repeat_of,
            "versions": dict(versions),
        }


@dataclasses.dataclass(frozen=True)
class MeshGarment:
    """A garment from a mesh file.

    Parameters
    ----------
    mesh : str
        Path; in a file, relative to it.
    pinned_above : float
        Metres; vertices at or above follow the body.
    """

    mesh: str
    pinned_above: float


@dataclasses.dataclass(frozen=True)
class DataSet:
    """Clips of one garment on one body.

    Attributes
    ----------
    name : str
    fps : float
    seed : int
    garment : Dress or MeshGarment
    body : str
        Path of a body file; empty: the one that ships.
    solver : Solver
    gate : Gate
    base : ParameterSet
        Simulated with every motion.
    motions : tuple of MotionSource
    sets : tuple of ParameterSet
        Simulated with `set_motions`.
    set_motions : tuple of MotionSource
    perturbation : float
        Metres; test clips are simulated once more from a start moved by so much.  0: not.
    """

    name: str
    fps: float
    seed: int
    garment: Dress | MeshGarment
    body: str
    solver: Solver
    gate: Gate
    base: ParameterSet
    motions: tuple[MotionSource, ...]
    sets: tuple[ParameterSet, ...] = ()
    set_motions: tuple[MotionSource, ...] = ()
    perturbation: float = 0.0

    def scenes(self) -> tuple[Scene, ...]:
        """Every clip, in the order in which they are made: base, test pairs, other sets."""
        found = [self._scene(self.base, m) for m in self.motions]
        found += [self._moved(s) for s in found if self.perturbation and s.motion.split == "test"]
        for parameters in self.sets:
            own = [self._scene(parameters, m) for m in self.set_motions]
            found += own
            found += [self._moved(s) for s in own if self.perturbation and s.motion.split == "test"]
        return tuple(found)

    def with_motions(self, motions: tuple[MotionSource, ...]) -> DataSet:
        """The same with further motions under the base parameters."""
        return dataclasses.replace(self, motions=self.motions + motions)

    def make_body(self) -> Body:
        return load_body(self.body) if self.body else default_body()

    def make_garment(self, body: Body) -> Garment:
        if isinstance(self.garment, Dress):
            return cut_dress(body, self.garment)
        return garment_from_mesh(body, self.garment.mesh, pinned_above=self.garment.pinned_above)

    def _scene(self, parameters: ParameterSet, motion: MotionSource) -> Scene:
        return Scene(f"{parameters.name}-{motion.name}", self, motion, parameters)

    def _moved(self, scene: Scene) -> Scene:
        return dataclasses.replace(
            scene,
            name=scene.name + _MOVED,
            perturbation=self.perturbation,
            repeat_of=scene.name,
        )
