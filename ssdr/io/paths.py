"""Paths that callers give: checked, with the format that reads them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ..errors import FormatError, InputError, is_real
from ..sequence import MeshSequence
from .registry import FORMATS, Format, format_of, format_to_read, is_many, refuse_device


def readable_path(
    path: Any, fps: float | None = None, scale: float = 1.0, function: str = "read"
) -> tuple[Path, Format]:
    """Check that a file can be read and the options are valid; return its path and format.

    `function` names the function that the format must have, such as ``"read"``.
    """
    for argument, value in (("fps", fps), ("scale", scale)):
        if value is not None and not (is_real(value) and value > 0):
            raise InputError(argument, "a positive number", repr(value))
    source = as_path(path)
    format_ = format_to_read(source) if function == "read" else format_of(source)[1]
    if not format_.has(function):
        able = ", ".join(sorted(s for s, f in FORMATS.items() if f.has(function)))
        what = "mesh" if function == "read" else "skinning"
        raise FormatError(f"{source}: no {what} can be read from {source.suffix}, only from {able}")
    if not (function == "read" and is_many(source)) and not source.exists():
        raise FileNotFoundError(f"{source}: no such file")
    if source.is_dir() and format_.module not in (FORMATS[".obj"].module, FORMATS[".zarr"].module):
        raise FormatError(f"{source}: a folder, not a file")
    refuse_device(source)
    return source, format_


def writable(kind: type | None = None) -> list[str]:
    able = ["write_sequence", *(["write_skinning"] if kind is not MeshSequence else [])]
    return sorted(suffix for suffix, format_ in FORMATS.items() if format_.has(*able))


def as_path(path: Any) -> Path:
    if not isinstance(path, (str, os.PathLike)) or "\0" in (name := str(os.fspath(path))):
        raise InputError("path", "a path", repr(path))
    return Path(name)
