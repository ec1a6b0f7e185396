"""Tables of TOML and JSON as dataclasses, decoded by msgspec.

Configurations of training, checkpoints, clips and scene files use it.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from ssdr.common.errors import FormatError, InputError

T = TypeVar("T")


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises
    ------
    FormatError
        If the file cannot be read or is not TOML; the message names it.
    """
    try:
        return parse_toml(path.read_text("utf-8"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        raise FormatError(f"{path}: not a text file that can be read ({error})") from error


def parse_toml(text: str, file: str) -> dict[str, Any]:
    """The tables of a text in TOML.

    Raises
    ------
    FormatError
        If the text is not TOML; the message names `file`.

    Examples
    --------
    >>> parse_toml("[low]\\nhidden = 600", "mine.toml")
    {'low': {'hidden': 600}}
    """
    try:
        return dict(msgspec.toml.decode(text))
    except msgspec.DecodeError as error:
        raise FormatError(f"{file}: not TOML ({error})") from error


def from_table(kind: type[T], table: Any, *, file: str, name: str = "") -> T:
    """Instance of a dataclass, read from a table; keys that are left out get the defaults.

    Parameters
    ----------
    kind : dataclass
        Its types say which values are accepted.
    table : dict
    file : str
        Name of the file that the table comes from.
    name : str
        Name of the table; empty for that of the whole file.

    Raises
    ------
    FormatError
        If a key is unknown or missing, or a value is of another type or out of its range.
    InputError
        If the dataclass refuses a value.  Both messages name the file and the key.

    Examples
    --------
    >>> import dataclasses
    >>> @dataclasses.dataclass(frozen=True)
    ... class Cut:
    ...     vertices: int = 1900
    ...     flare: float = 0.42
    >>> from_table(Cut, {"flare": 1}, file="c.toml")
    Cut(vertices=1900, flare=1.0)
    >>> from_table(Cut, {"flair": 1}, file="c.toml")
    Traceback (most recent call last):
    ssdr.FormatError: c.toml: flair: expected one of vertices, flare, got this key
    """
    try:
        found = msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        refused = error.__cause__
        if not isinstance(refused, InputError):
            raise FormatError(": ".join(filter(None, (file, name, str(error))))) from error
        place = re.search(r"`\$\.?(.*)`\Z", str(error))
        key = ".".join(filter(None, (name, place and place[1], refused.argument)))
        raise InputError(f"{file}: {key}", refused.expected, refused.got) from error
    whole: Any = found
    _check_keys(table, dataclasses.asdict(whole), file, name)
    return found


def _check_keys(table: Any, known: Any, file: str, name: str) -> None:
    """Raise a FormatError for a key of `table` that is not `known`: msgspec passes it over."""
    if isinstance(known, dict):
        for key, value in table.items():
            here = f"{name}.{key}" if name else str(key)
            if key not in known:
                raise FormatError(
                    f"{file}: {here}: expected one of {', '.join(known)}, got this key"
                )
            _check_keys(value, known[key], file, here)
    elif isinstance(known, (list, tuple)):
        for k, (value, item) in enumerate(zip(table, known, strict=True)):
            _check_keys(value, item, file, f"{name}[{k}]")
