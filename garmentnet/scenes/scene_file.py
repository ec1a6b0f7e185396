"""A scene or a data set read from a TOML file."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, get_args

from ssdr.errors import FormatError, InputError

from ..data.clip_files import Split
from ..data.parameters import SimulationParameters
from ..io.tables import from_table, read_toml
from .cloth import Solver
from .dance.choreography import Repertoire
from .garments import Dress
from .quality import Gate
from .scene import DataSet, MeshGarment, MotionSource, ParameterSet

__all__ = ["load_data_set", "presets"]

_PRESETS = Path(__file__).with_name("presets")
# Seeds of the splits, and after them those of the other parameter sets, lie this far apart, so
# that one can grow without changing another's.
_SEEDS_OF_A_SPLIT = 1000


def presets() -> tuple[str, ...]:
    """Names of the data sets that ship with the package.

    Examples
    --------
    >>> presets()
    ('large', 'medium', 'small', 'tiny')
    """
    return tuple(sorted(p.stem for p in _PRESETS.glob("*.toml")))


def load_data_set(source: str | Path) -> DataSet:
    """Read a data set or a scene: the name of a preset or a file.

    Raises
    ------
    FormatError
        If the file is not TOML, has a key that nothing reads, or a value that is not usable;
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
        return _data_set(from_table(_File, read_toml(path), file=str(path)), path)
    except InputError as error:
        raise FormatError(str(error)) from error


@dataclasses.dataclass(frozen=True)
class _Motions:
    """``[motions]``: dances of the generator."""

    train: int
    validation: int = 0
    test: int = 0
    frames: int = 300
    seed: int = 0
    repertoire: Repertoire = "basic"
    # Length of the training dances, if another: settling costs as much for a short clip.
    train_frames: int = 0
    # For the other parameter sets: how many of each split, the first of them, and how long.
    set_train: int = 0
    set_test: int = 0
    set_frames: int = 0
    # Training sets get so many dances of their own instead of the first ones of the base.
    set_own: int = 0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            least = 1 if field.name in ("train", "frames") else 0
            if field.type == "int" and getattr(self, field.name) < least:
                raise InputError(field.name, f"an integer >= {least}", getattr(self, field.name))
        for split in ("train", "test"):
            count, most = getattr(self, f"set_{split}"), getattr(self, split)
            if count > most:
                raise InputError(f"set_{split}", f"at most {most}, as {split}", count)


@dataclasses.dataclass(frozen=True)
class _Further:
    """``[[further]]``: more dances under the base parameters, of a name of their own."""

    name: str
    split: Split = "test"
    count: int = 1
    frames: int = 300
    seed: int = 0
    repertoire: Repertoire = "basic"

    def __post_init__(self) -> None:
        for name, least in (("count", 1), ("frames", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise InputError(name, f"an integer >= {least}", getattr(self, name))
        if not self.name.isidentifier() or self.name == "dance":
            raise InputError("name", 'letters, digits and _, not "dance"', self.name)

    def sources(self) -> list[MotionSource]:
        return [
            MotionSource(
                f"{self.name}-{s:04d}", self.split, s, self.frames, repertoire=self.repertoire
            )
            for s in range(self.seed, self.seed + self.count)
        ]


@dataclasses.dataclass(frozen=True)
class _Set:
    """``[[set]]``: one of the further parameter sets."""

    name: str = ""
    split: Split = "train"
    bending: float = SimulationParameters.bending
    density: float = SimulationParameters.density
    time_scale: float = SimulationParameters.time_scale

    def __post_init__(self) -> None:
        self.parameters()

    def parameters(self) -> SimulationParameters:
        return SimulationParameters(self.bending, self.density, self.time_scale)


@dataclasses.dataclass(frozen=True)
class _Body:
    """``[body]``: a body of one's own; the one that ships by default."""

    file: str = ""


@dataclasses.dataclass(frozen=True)
class _File:
    """All that a scene file may hold."""

    name: str = ""
    fps: float = 30.0
    seed: int = 0
    perturbation: float = 0.0
    perturb_sets: bool = True
    garment: dict[str, Any] = dataclasses.field(default_factory=dict)
    body: _Body = _Body()
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
        if self.seed < 0:
            raise InputError("seed", "an integer >= 0", self.seed)
        if (self.motions is None) == (self.motion is None):
            raise InputError("motion, motions", "one of the two", "both" if self.motion else "none")


def _data_set(content: _File, path: Path) -> DataSet:
    garment: Dress | MeshGarment
    if "mesh" in content.garment:
        read = from_table(MeshGarment, content.garment, file=str(path), name="garment")
        garment = dataclasses.replace(read, mesh=str(path.parent / read.mesh))
    else:
        garment = from_table(Dress, content.garment, file=str(path), name="garment")
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
        body=str(path.parent / content.body.file) if content.body.file else "",
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
    counts: dict[Split, tuple[int, int]] = {
        "train": (g.train, g.train_frames or g.frames),
        "validation": (g.validation, g.frames),
        "test": (g.test, g.frames),
    }
    return [
        MotionSource(f"dance-{s:04d}", split, s, frames, repertoire=g.repertoire)
        for k, (split, (count, frames)) in enumerate(counts.items())
        for s in _seeds(g, content.seed, k, count)
    ]


def _set_motions(
    content: _File, split: Split, k: int, motions: tuple[MotionSource, ...]
) -> tuple[MotionSource, ...]:
    """Motions of the `k`-th of the other parameter sets, given those of the base."""
    g = content.motions
    if g is None:
        return ()
    train = [m for m in motions if m.split == "train"][: g.set_train]
    test = [m for m in motions if m.split == "test"][: g.set_test]
    if g.set_own and split == "train":
        frames = g.train_frames or g.frames
        train = [
            MotionSource(f"dance-{s:04d}", "train", s, frames, repertoire=g.repertoire)
            for s in _seeds(g, content.seed, len(get_args(Split)) + k, g.set_own)
        ]
    most = g.set_frames or max(g.frames, g.train_frames)
    return tuple(
        dataclasses.replace(m, frames=most, whole=m.frames) if m.frames > most else m
        for m in train + test
    )


def _seeds(g: _Motions, seed: int, block: int, count: int) -> range:
    first = g.seed + seed + _SEEDS_OF_A_SPLIT * block
    return range(first, first + count)
