"""Parsing of ``--read`` and ``--write``, the options for formats of files."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import FormatError, InputError, check_flag
from ..io.formats import FORMATS, Format, format_to_read, option_names
from ..io.references import trust
from .options import Options, SpaceOptions

_PREFIX = re.compile(r"\.?(\w+):(?=\w+=)")
_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
PLACED = {"scale", "units", "up"}  # arguments of ssdr.load that move a mesh or say where it is


def read_options(
    paths: Sequence[Path], options: Options, *, roles: Sequence[str] = ()
) -> list[dict[str, Any]]:
    """Keyword arguments of :func:`ssdr.load` for each file.

    They come from ``--read``: ``key=value`` is for every file whose format has the option `key`,
    ``suffix:key=value`` only for files of that suffix, and ``A:key=value`` only for the file with
    the role A. `roles` lists the roles in the order of `paths`.

    Raises
    ------
    InputError
        If no file's format has an option, or the text before the colon is neither the suffix nor
        the role of a file.
    """
    shared: dict[str, Any] = {}
    if isinstance(options, SpaceOptions):
        shared = {"units": _metres(options.units), "up": options.up}
    result = [{k: v for k, v in shared.items() if v is not None} for _ in paths]
    for pair in options.read or ():
        prefix, key, value = _parse("--read", pair)
        meant = [
            k
            for k, path in enumerate(paths)
            if prefix in ("", *roles[k : k + 1]) or prefix.lower() == _suffix(path)
        ]
        if not meant:
            before = ", ".join([*roles, "the suffix of an input"])
            raise InputError("--read", f"{before} before the colon", pair)
        known = {k: _known(paths[k]) for k in meant}
        takers = [k for k in meant if key in known[k]]
        if key == "weld":
            check_flag(value, "weld")
        if key == "folder":
            trust(value)
            continue
        if not takers:
            wanted = ", ".join(sorted(set().union(*known.values())))
            files = ", ".join(str(paths[k]) for k in meant)
            raise InputError("--read", f"one of {wanted} for {files}", key)
        for k in takers:
            result[k][key] = value
    return result


def write_options(pairs: list[str] | None, path: Path) -> dict[str, Any]:
    """Keyword arguments of :func:`ssdr.save` for one file, from the values of ``--write``.

    Raises
    ------
    InputError
        If the text before a colon is not the suffix of a format.
    """
    options = {}
    for pair in pairs or ():
        prefix, key, value = _parse("--write", pair)
        # The format may be one that this command does not write.
        if prefix and f".{prefix.lower()}" not in FORMATS:
            raise InputError("--write", "the suffix of a format before the colon", pair)
        if prefix.lower() in ("", _suffix(path)):
            options[key] = value
    return options


def readable_format(path: Path) -> Format | None:
    """Format by which a file is read, or None if there is none."""
    try:
        return format_to_read(path)
    except FormatError:
        return None


def _known(path: Path) -> set[str]:
    """Names of the keyword arguments with which a file can be read."""
    format_ = readable_format(path)
    of_format: set[str] = set()
    if format_ is not None:
        functions = format_.functions()
        of_format |= set(option_names(functions.read))
        if functions.read_skinning is not None:
            of_format |= set(option_names(functions.read_skinning))
    return (of_format | {"weld", "fps", "folder"} | PLACED) - {"clip"}


def _metres(text: str | None) -> float | None:
    """Parse ``--units``: metres in a unit, or the symbol of a unit."""
    try:
        return None if text is None else _UNITS.get(text) or float(text)
    except ValueError:
        raise InputError("--units", f"metres, or {', '.join(_UNITS)}", repr(text)) from None


def _suffix(path: Path) -> str:
    return path.suffix.lower().removeprefix(".")


def _parse(option: str, pair: str) -> tuple[str, str, Any]:
    """Prefix, key and value of ``PREFIX:KEY=VALUE``; a value that is not JSON stays a text."""
    match = _PREFIX.match(pair)
    key, equals, value = pair[match.end() if match else 0 :].partition("=")
    if not equals or not key.isidentifier():
        raise InputError(option, "KEY=VALUE", repr(pair))
    prefix = match[1] if match else ""
    try:
        return prefix, key, json.loads(value)
    except ValueError:
        return prefix, key, value
