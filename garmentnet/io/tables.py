"""Reading of TOML and JSON tables into frozen dataclasses, with checks of keys, types and numbers.

Configurations of training and scene files use it.
"""

from __future__ import annotations

import dataclasses
import tomllib
import types
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from ssdr.common.errors import FormatError, InputError

T = TypeVar("T")
_KINDS = {bool: "true or false", int: "an integer", float: "a number", str: "a string"}


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
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FormatError(f"{file}: not TOML ({error})") from error


def from_table(kind: type[T], table: Any, *, file: str, name: str = "") -> T:
    """Instance of a dataclass, read from a table; keys that are left out get the defaults.

    Fields may be bool, int, float (an integer will do), str, a ``Literal``, ``dict[str, Any]``
    (any table), another dataclass (a table of its own), a tuple of one of these (a list), one of
    these or None, and one of several dataclasses: the first that has all keys of the table, or the
    first of all.

    Parameters
    ----------
    kind : dataclass
    table : dict
    file : str
        Name of the file that the table comes from.
    name : str
        Name of the table; empty for that of the whole file.

    Raises
    ------
    FormatError
        If a key is unknown or missing or a value is of another type.
    InputError
        If the dataclass refuses a value, a number out of its range for instance.  Both messages
        name the file, the table, the key, what was expected and what came.

    Examples
    --------
    >>> import dataclasses
    >>> @dataclasses.dataclass(frozen=True)
    ... class Cut:
    ...     vertices: int = 1900
    ...     flare: float = 0.42
    >>> from_table(Cut, {"flare": 1}, file="c.toml", name="garment")
    Cut(vertices=1900, flare=1.0)
    >>> from_table(Cut, {"flair": 1}, file="c.toml", name="garment")
    Traceback (most recent call last):
    ssdr.FormatError: c.toml: garment.flair: expected one of vertices, flare, got this key
    """
    assert dataclasses.is_dataclass(kind)
    if not isinstance(table, dict):
        raise _error(file, name or "all of it", "a table", repr(table))
    prefix = f"{name}." if name else ""
    hints, values = get_type_hints(kind), {}
    fields = {f.name: f for f in dataclasses.fields(kind)}
    for key, value in table.items():
        if key not in fields:
            raise _error(file, prefix + str(key), f"one of {', '.join(fields)}", "this key")
        values[key] = _value(hints[key], value, file, prefix + key)
    for key, field in fields.items():
        required = field.default is field.default_factory is dataclasses.MISSING
        if required and key not in values:
            raise _error(file, prefix + key, "a value", "none")
    try:
        return kind(**values)
    except InputError as error:
        argument = f"{file}: {prefix}{error.argument}"
        raise InputError(argument, error.expected, error.got) from error


def _value(hint: Any, value: Any, file: str, key: str) -> Any:
    if get_origin(hint) is Literal:
        if value not in get_args(hint):
            raise _error(file, key, f"one of {get_args(hint)}", repr(value))
        return value
    if get_origin(hint) is types.UnionType:
        kinds = get_args(hint)
        hint = next((k for k in kinds if _has_keys(k, value)), kinds[0])
        return None if value is None else _value(hint, value, file, key)
    if get_origin(hint) is tuple:
        if not isinstance(value, (list, tuple)):
            raise _error(file, key, "a list", repr(value))
        item = get_args(hint)[0]
        tables = dataclasses.is_dataclass(item)
        return tuple(
            _value(item, v, file, f"{key}[{k}]" if tables else key) for k, v in enumerate(value)
        )
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return from_table(hint, value, file=file, name=key)
    if get_origin(hint) is dict:
        if not isinstance(value, dict):
            raise _error(file, key, "a table", repr(value))
        return value
    if hint is float and type(value) is int:
        return float(value)
    if type(value) is not hint:
        raise _error(file, key, _KINDS[hint], repr(value))
    return value


def _has_keys(kind: Any, table: Any) -> bool:
    names = {f.name for f in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else set()
    return isinstance(table, dict) and set(table) <= names


def _error(file: str, key: str, expected: str, got: str) -> FormatError:
    return FormatError(f"{file}: {key}: expected {expected}, got {got}")
