"""Reading of a scene or a data set from a TOML file."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

from ssdr.errors import FormatError, InputError

from ..io.tables import from_table, read_toml
from .scene import DataSet, MeshGarment

__all__ = ["load_data_set", "presets"]

_PRESETS = Path(__file__).with_name("presets")


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
        read = from_table(DataSet, _table(path), file=str(path))
    except InputError as error:
        raise FormatError(str(error)) from error
    garment, motion = read.garment, read.motion
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
        base[key] = base[key] | value if both else value
    return base
