"""Scenes and data sets: what a TOML file says of them, and the clips that they consist of.

A :class:`DataSet` is one garment on one body with any number of motions and parameter sets.  It
expands to one :class:`SceneDescription` for each clip, in a fixed order and with fixed names.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from garmentnet.data.parameters import SimulationParameters
from garmentnet.importing.quality import LIMITS
from garmentnet.io.tables import from_table, read_toml
from ssdr.common.errors import FormatError, InputError, is_real

from .body import Body, default_body, load_body
from .cloth import Solver
from .cut import Cut, cut_garment
from .garments import Garment, garment_from_mesh
from .limits import check_numbers
from .motion_sources import SPLITS, Dances, DancesOfSplits, MotionSource
from .simulator import VERSION

_PRESETS = Path(__file__).with_name("presets")
# Suffix of the name of a perturbed clip.
_PERTURBED = "-moved"


@dataclasses.dataclass(frozen=True)
class ParameterSet(SimulationParameters):
    """Simulation parameters with a name, and their split for the ensemble.

    Parameters
    ----------
    bending, density, time_scale : float
    name : str
    split : {"train", "test"}
        Networks are trained only on "train".
    """

    name: str = ""
    split: Literal["train", "test"] = "train"

    @property
    def parameters(self) -> SimulationParameters:
        """The numbers alone."""
        return SimulationParameters(self.bending, self.density, self.time_scale)


@dataclasses.dataclass(frozen=True)
class SceneDescription:
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
            "gate": self.data_set.gate,
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
        Added to the seeds of `motions` and of the perturbations.
    perturbation : float
        RMS displacement, metres, of the perturbed start from which test clips of the base
        parameters are simulated a second time; with 0 they are not.
    garment : Cut or MeshGarment
    body : str
        Path of a body file; empty: the one that ships.
    solver : Solver
    gate : dict
        Other limits of a clip's quality, by name.
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
    >>> tiny = load_data_set("tiny")
    >>> tiny.scenes()[0].name
    'base-dance-0000'
    """

    name: str = ""
    fps: float = 30.0
    seed: int = 0
    perturbation: float = 0.0
    garment: Any = dataclasses.field(default_factory=Cut)
    body: str = ""
    solver: Solver = dataclasses.field(default_factory=Solver)
    gate: dict[str, Any] = dataclasses.field(default_factory=dict)
    base: SimulationParameters = dataclasses.field(default_factory=SimulationParameters)
    motions: DancesOfSplits | None = None
    motion: MotionSource | None = None
    further: tuple[Dances, ...] = ()
    set: tuple[ParameterSet, ...] = ()

    def __post_init__(self) -> None:
        check_numbers(self, fps=(1, 120), perturbation=(0, 0.1))
        for name, most in self.gate.items():
            if name not in LIMITS or not is_real(most):
                raise InputError("gate", f"numbers for {', '.join(LIMITS)}", f"{name} = {most!r}")
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
        base = {split: table.sources(split, self.seed) for split in SPLITS}
        every = tuple(m for dances in (*base.values(), further) for m in dances)
        some = tuple(m for s in SPLITS for m in base[s][: getattr(table, f"set_{s}")])
        return (every, *(some for _ in self.set))

    def scenes(self, recorded: Sequence[MotionSource] = ()) -> tuple[SceneDescription, ...]:
        """One scene for each clip: base parameters, their perturbed test clips, other sets.

        `recorded` are further motions under the base parameters.
        """
        first, *others = self.sources
        base, *sets = (
            [SceneDescription(f"{p.name}-{m.name}", self, m, p) for m in motions]
            for p, motions in zip(self.sets, [(*first, *recorded), *others], strict=True)
        )
        again = [
            dataclasses.replace(
                scene,
                name=scene.name + _PERTURBED,
                perturbation=self.perturbation,
                repeat_of=scene.name,
            )
            for scene in base
            if self.perturbation and scene.motion.split == "test"
        ]
        return tuple(itertools.chain(base, again, *sets))

    def make_body(self) -> Body:
        return load_body(self.body) if self.body else default_body()

    def make_garment(self, body: Body) -> Garment:
        if isinstance(self.garment, Cut):
            return cut_garment(body, self.garment)
        return garment_from_mesh(body, self.garment.mesh, pinned_above=self.garment.pinned_above)


def presets() -> tuple[str, ...]:
    """Names of the data sets that ship with the package.

    Examples
    --------
    >>> "trousers" in presets()
    True
    """
    return tuple(sorted(p.stem for p in _PRESETS.glob("*.toml")))


def load_data_set(source: str | Path) -> DataSet:
    """Read a data set or a scene from a file, or a preset by its name.

    A file that is ``like`` a preset holds only what differs from the preset, and whole lists if one
    of their items does.

    Raises
    ------
    FormatError
        If the file is not TOML, has an unknown key or a value that is not usable;
        the message names the file and the key.

    Examples
    --------
    >>> tiny = load_data_set("tiny")
    >>> tiny.garment.vertices, len(tiny.scenes())
    (500, 23)
    """
    path = Path(source)
    if str(source) in presets():
        path = _PRESETS / f"{source}.toml"
    if not path.is_file():
        raise FormatError(f"{path}: no such file, nor a preset ({', '.join(presets())})")
    table = _table(path)
    cut = table.pop("garment", {})
    kind = MeshGarment if isinstance(cut, dict) and "mesh" in cut else Cut
    try:
        garment: Any = from_table(kind, cut, file=str(path), name="garment")
        read = from_table(DataSet, table, file=str(path))
    except InputError as error:
        raise FormatError(str(error)) from error
    motion = read.motion
    if isinstance(garment, MeshGarment):
        garment = dataclasses.replace(garment, mesh=str(path.parent / garment.mesh))
    if motion is not None and motion.file:
        motion = dataclasses.replace(motion, file=str(path.parent / motion.file))
    return dataclasses.replace(
        read,
        name=read.name or path.stem,
        garment=garment,
        motion=motion,
        body=str(path.parent / read.body) if read.body else "",
    )


def _table(path: Path) -> dict[str, Any]:
    """Tables of a file, merged with those of the preset that it is ``like``."""
    table = read_toml(path)
    like = table.pop("like", None)
    if like is None:
        return table
    if like not in presets() or like == path.stem:
        raise FormatError(f"{path}: like: expected one of {', '.join(presets())}, got {like!r}")
    base = _table(_PRESETS / f"{like}.toml") | {"name": ""}
    for key, value in table.items():
        both = isinstance(value, dict) and isinstance(base.get(key), dict)
        # A mesh takes the place of a cut.
        both = both and ("mesh" in value) == ("mesh" in base[key])
        base[key] = base[key] | value if both else value
    return base
