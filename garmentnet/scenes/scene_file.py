"""Reading of a scene or a data set from a TOML file."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, get_args

from ssdr.errors import FormatError, InputError

from ..data.clip_files import Split
from ..data.parameters import SimulationParameters
from ..io.tables import from_table, read_toml
from .cloth import Solver
from .cut import Cut
from .dance.choreography import Repertoire
from .quality import Gate
from .scene import DataSet, MeshGarment, MotionSource, ParameterSet, check_integers

__all__ = ["load_data_set", "presets"]

_PRESETS = Path(__file__).with_name("presets")
# Distance between the first seeds of the splits, and of the further parameter sets after them, so
# that one can grow without changing the others.
_SEEDS_OF_A_SPLIT = 1000


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
    (500, 30)
    """
    path = Path(source)
    if str(source) in presets():
        path = _PRESETS / f"{source}.toml"
    if not path.is_file():
        raise FormatError(f"{path}: no such file, nor a preset ({', '.join(presets())})")
    try:
        return _data_set(from_table(_File, _table(path), file=str(path)), path)
    except InputError as error:
        raise FormatError(str(error)) from error


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
        base[key] = base[key] | value if both else value
    return base


@dataclasses.dataclass(frozen=True)
class _Motions:
    """Table ``[motions]``: dances made by the generator."""

    train: int
    validation: int = 0
    test: int = 0
    frames: int = 300
    seed: int = 0
    repertoire: Repertoire = "basic"
    # Frames of a training dance, which may be longer, since settling takes as long for a short one;
    # 0 stands for `frames`.
    train_frames: int = 0
    # Numbers of the base's dances in each split that further parameter sets repeat, and how many
    # frames of each.
    set_train: int = 0
    set_validation: int = 0
    set_test: int = 0
    set_frames: int = 0
    # Number of dances that each further training set has for itself, instead of the base's first.
    set_own: int = 0

    def __post_init__(self) -> None:
        check_integers(self, positive=("train", "frames"))
        for split in get_args(Split):
            count, most = getattr(self, f"set_{split}"), getattr(self, split)
            if count > most:
                raise InputError(f"set_{split}", f"at most {most}, as {split}", count)


@dataclasses.dataclass(frozen=True)
class _Further:
    """Table ``[[further]]``: more dances under the base parameters, with another name."""

    name: str
    split: Split = "test"
    count: int = 1
    frames: int = 300
    seed: int = 0
    repertoire: Repertoire = "basic"

    def __post_init__(self) -> None:
        check_integers(self, positive=("count", "frames"))
        if not self.name.isidentifier() or self.name == "dance":
            raise InputError("name", 'letters, digits and _, not "dance"', self.name)

    def sources(self) -> list[MotionSource]:
        seeds = range(self.seed, self.seed + self.count)
        return _dances(self.name, self.split, seeds, self.frames, self.repertoire)


@dataclasses.dataclass(frozen=True)
class _Set(SimulationParameters):
    """Table ``[[set]]``: a further parameter set."""

    name: str = ""
    split: Split = "train"

    def __post_init__(self) -> None:
        self.parameters()

    def parameters(self) -> SimulationParameters:
        return SimulationParameters(self.bending, self.density, self.time_scale)


@dataclasses.dataclass(frozen=True)
class _File:
    """Everything that a scene file may hold."""

    name: str = ""
    fps: float = 30.0
    seed: int = 0
    perturbation: float = 0.0
    perturb_sets: bool = True
    garment: dict[str, Any] = dataclasses.field(default_factory=dict)
    body: str = ""  # file of another body than the one that ships
    solver: Solver = dataclasses.field(default_factory=Solver)
    gate: Gate = dataclasses.field(default_factory=Gate)
    base: SimulationParameters = dataclasses.field(default_factory=SimulationParameters)
    motions: _Motions | None = None
    motion: MotionSource | None = None
    further: tuple[_Further, ...] = ()
    set: tuple[_Set, ...] = ()

    def __post_init__(self) -> None:
        if not 1 <= self.fps <= 120:
            raise InputError("fps", "1 to 120", self.fps)
        if not 0 <= self.perturbation <= 0.1:
            raise InputError("perturbation", "0 to 0.1", self.perturbation)
        check_integers(self)
        if (self.motions is None) == (self.motion is None):
            raise InputError("motion, motions", "one of the two", "both" if self.motion else "none")


def _data_set(content: _File, path: Path) -> DataSet:
    garment: Cut | MeshGarment
    if "mesh" in content.garment:
        read = from_table(MeshGarment, content.garment, file=str(path), name="garment")
        garment = dataclasses.replace(read, mesh=str(path.parent / read.mesh))
    else:
        garment = from_table(Cut, content.garment, file=str(path), name="garment")
    sets = tuple(
        ParameterSet(s.name or f"set{k + 1:02d}", s.split, s.parameters())
        for k, s in enumerate(content.set)
    )
    motions = tuple(_base_motions(content, path))
    further = [m for group in content.further for m in group.sources()]
    return DataSet(
        name=content.name or path.stem,
        fps=content.fps,
        seed=content.seed,
        garment=garment,
        body=str(path.parent / content.body) if content.body else "",
        solver=content.solver,
        gate=content.gate,
        base=ParameterSet("base", "train", content.base),
        motions=(*motions, *further),
        sets=sets,
        set_motions=tuple(_set_motions(content, s.split, k, motions) for k, s in enumerate(sets)),
        perturbation=content.perturbation,
        perturb_sets=content.perturb_sets,
    )


def _base_motions(content: _File, path: Path) -> list[MotionSource]:
    """Motions of the base parameters."""
    if content.motion is not None:
        one = content.motion
        file = str(path.parent / one.file) if one.file else ""
        stem = Path(one.file).name.split(".")[0] if one.file else f"dance-{one.seed:04d}"
        return [dataclasses.replace(one, name=one.name or stem, file=file)]
    assert content.motions is not None
    g = content.motions
    motions: list[MotionSource] = []
    for k, split in enumerate(get_args(Split)):
        seeds = _seeds(g, content.seed, k, getattr(g, split))
        frames = (split == "train" and g.train_frames) or g.frames
        motions += _dances("dance", split, seeds, frames, g.repertoire)
    return motions


def _set_motions(
    content: _File, split: Split, k: int, motions: tuple[MotionSource, ...]
) -> tuple[MotionSource, ...]:
    """Motions of the `k`-th further parameter set, given those of the base."""
    g = content.motions
    if g is None:
        return ()
    train, validation, test = (
        [m for m in motions if m.split == s][: getattr(g, f"set_{s}")] for s in get_args(Split)
    )
    if g.set_own and split == "train":
        seeds = _seeds(g, content.seed, len(get_args(Split)) + k, g.set_own)
        train = _dances("dance", "train", seeds, g.train_frames or g.frames, g.repertoire)
    most = g.set_frames or max(g.frames, g.train_frames)
    return tuple(
        dataclasses.replace(m, frames=most, whole=m.frames) if m.frames > most else m
        for m in train + validation + test
    )


def _dances(
    name: str, split: Split, seeds: range, frames: int, repertoire: Repertoire
) -> list[MotionSource]:
    return [MotionSource(f"{name}-{s:04d}", split, s, frames, repertoire=repertoire) for s in seeds]


def _seeds(g: _Motions, seed: int, block: int, count: int) -> range:
    first = g.seed + seed + _SEEDS_OF_A_SPLIT * block
    return range(first, first + count)
