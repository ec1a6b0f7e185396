"""A scene or a data set read from a file (TOML), every key and type checked."""

from __future__ import annotations

import dataclasses
import tomllib
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from ssdr.errors import FormatError, InputError

from ..data.clip_files import Split
from ..data.parameters import SimulationParameters
from .cloth import Solver
from .dance.choreography import DANCE_CLASSES
from .garments import Dress
from .quality import Gate
from .scene import DataSet, MeshGarment, MotionSource, ParameterSet

__all__ = ["load_data_set", "presets"]

_PRESETS = Path(__file__).with_name("presets")
T = TypeVar("T")


def presets() -> tuple[str, ...]:
    """Names of the data sets that ship with the package."""
    return tuple(sorted(p.stem for p in _PRESETS.glob("*.toml")))


def load_data_set(source: str | Path) -> DataSet:
    """Read a data set or a scene: the name of a preset or a file.

    Raises
    ------
    FormatError
        If the file is not TOML, has a key that nothing reads, or a value that is not usable;
        the message names the file and the key.
    """
    path = Path(source)
    if str(source) in presets():
        path = _PRESETS / f"{source}.toml"
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise FormatError(f"{path}: no such file, nor a preset ({', '.join(presets())})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FormatError(f"{path}: {error}") from error
    try:
        return _data_set(table, path)
    except InputError as error:
        raise FormatError(f"{path}: {error}") from error


@dataclasses.dataclass(frozen=True)
class _Generated:
    """``[motions]``: dances of the generator."""

    train: int
    validation: int = 0
    test: int = 0
    frames: int = 300
    seed: int = 0
    # For the other parameter sets: the first of each, and how long.
    set_train: int = 0
    set_test: int = 0
    set_frames: int = 0


@dataclasses.dataclass(frozen=True)
class _Single:
    """``[motion]``: one motion, for a scene."""

    seed: int = 0
    frames: int = 300
    classes: tuple[str, ...] = ()
    file: str = ""
    start: int = 0
    split: Split = "train"


def _data_set(table: dict[str, Any], path: Path) -> DataSet:
    sections = {"garment", "body", "solver", "gate", "base", "motions", "motion", "set"}
    scalars = {"name", "fps", "seed", "perturbation"}
    for key in table:
        if key not in sections | scalars:
            raise InputError(key, f"one of {', '.join(sorted(sections | scalars))}", "this key")
    if ("motions" in table) == ("motion" in table):
        raise InputError("motion, motions", "one of the two", "both" if "motion" in table else "-")
    head = _build(_Head, {k: v for k, v in table.items() if k in scalars}, "")
    garment = _section(table, "garment")
    made: Dress | MeshGarment
    if "mesh" in garment:
        from_file = _build(MeshGarment, garment, "garment")
        made = dataclasses.replace(from_file, mesh=str(path.parent / from_file.mesh))
    else:
        made = _build(Dress, garment, "garment")
    body = _build(_BodyFile, _section(table, "body"), "body").file
    base = ParameterSet(
        "base", "train", _build(SimulationParameters, _section(table, "base"), "base")
    )
    rows = table.get("set", [])
    if not isinstance(rows, list):
        raise InputError("set", "tables [[set]]", type(rows).__name__)
    sets = tuple(_parameter_set(row, k) for k, row in enumerate(rows))
    motions, set_motions = _motions(table, path, head.seed)
    return DataSet(
        name=head.name or path.stem,
        fps=head.fps,
        seed=head.seed,
        garment=made,
        body=str(path.parent / body) if body else "",
        solver=_build(Solver, _section(table, "solver"), "solver"),
        gate=_build(Gate, _section(table, "gate"), "gate"),
        base=base,
        motions=motions,
        sets=sets,
        set_motions=set_motions,
        perturbation=head.perturbation,
    )


@dataclasses.dataclass(frozen=True)
class _Head:
    name: str = ""
    fps: float = 30.0
    seed: int = 0
    perturbation: float = 0.0

    def __post_init__(self) -> None:
        if not 1 <= self.fps <= 120:
            raise InputError("fps", "1 to 120", self.fps)
        if not 0 <= self.perturbation <= 0.1:
            raise InputError("perturbation", "0 to 0.1", self.perturbation)
        if self.seed < 0:
            raise InputError("seed", "an integer >= 0", self.seed)


@dataclasses.dataclass(frozen=True)
class _BodyFile:
    file: str = ""


def _parameter_set(row: Any, number: int) -> ParameterSet:
    where = f"set[{number}]"
    if not isinstance(row, dict):
        raise InputError(where, "a table", row)
    row = dict(row)
    split = row.pop("split", "train")
    _check_split(split, f"{where}.split")
    name = row.pop("name", f"set{number + 1:02d}")
    return ParameterSet(str(name), split, _build(SimulationParameters, row, where))


def _motions(
    table: dict[str, Any], path: Path, seed: int
) -> tuple[tuple[MotionSource, ...], tuple[MotionSource, ...]]:
    if "motion" in table:
        one = _build(_Single, _section(table, "motion"), "motion")
        _check_split(one.split, "motion.split")
        for c in one.classes:
            if c not in DANCE_CLASSES:
                raise InputError("motion.classes", f"some of {', '.join(DANCE_CLASSES)}", c)
        if one.frames < 1 or one.start < 0 or one.seed < 0:
            raise InputError("motion", "frames >= 1, start and seed >= 0", one)
        file = str(path.parent / one.file) if one.file else ""
        stem = Path(one.file).name.split(".")[0] if one.file else f"dance-{one.seed:04d}"
        made = MotionSource(stem, one.split, one.seed, one.frames, one.classes, file, one.start)
        return (made,), ()
    g = _build(_Generated, _section(table, "motions"), "motions")
    for field in dataclasses.fields(g):
        if getattr(g, field.name) < (1 if field.name in ("train", "frames") else 0):
            raise InputError(f"motions.{field.name}", "a larger number", getattr(g, field.name))
    found: list[MotionSource] = []
    counts: tuple[tuple[Split, int], ...] = (
        ("train", g.train),
        ("validation", g.validation),
        ("test", g.test),
    )
    for k, (split, count) in enumerate(counts):
        # Seeds of a split do not move when another one grows.
        first = g.seed + seed + 1000 * k
        found += [
            MotionSource(f"dance-{first + i:04d}", split, first + i, g.frames) for i in range(count)
        ]
    short = []
    for split, count in (("train", g.set_train), ("test", g.set_test)):
        own = [m for m in found if m.split == split]
        if count > len(own):
            raise InputError(f"motions.set_{split}", f"at most {len(own)}", count)
        short += [
            dataclasses.replace(m, frames=min(g.frames, g.set_frames or g.frames), whole=g.frames)
            for m in own[:count]
        ]
    return tuple(found), tuple(short)


def _section(table: dict[str, Any], name: str) -> dict[str, Any]:
    section = table.get(name, {})
    if not isinstance(section, dict):
        raise InputError(name, "a table", type(section).__name__)
    return section


def _check_split(value: object, where: str) -> None:
    if value not in typing.get_args(Split):
        raise InputError(where, f"one of {typing.get_args(Split)}", repr(value))


def _build(kind: type[T], values: Mapping[str, Any], where: str) -> T:
    """A dataclass from a table, every key and type checked."""
    assert dataclasses.is_dataclass(kind)
    hints = typing.get_type_hints(kind)
    names = [f.name for f in dataclasses.fields(kind)]
    label = f"{where}." if where else ""
    given: dict[str, Any] = {}
    for key, value in values.items():
        if key not in names:
            raise InputError(f"{label}{key}", f"one of {', '.join(names)}", "this key")
        given[key] = _converted(value, hints[key], f"{label}{key}")
    missing = [
        f.name
        for f in dataclasses.fields(kind)
        if f.default is dataclasses.MISSING and f.name not in given
    ]
    if missing:
        raise InputError(f"{label}{missing[0]}", "a value", "none")
    try:
        return kind(**given)
    except InputError as error:
        raise InputError(f"{label}{error.argument}", error.expected, error.got) from error


def _converted(value: Any, hint: Any, where: str) -> Any:
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if isinstance(hint, types.GenericAlias):
        if isinstance(value, list) and all(isinstance(v, str) for v in value):
            return tuple(value)
        raise InputError(where, "a list of strings", repr(value))
    plain = str if typing.get_origin(hint) is typing.Literal else hint
    if type(value) is not plain:
        raise InputError(where, plain.__name__, repr(value))
    return value
