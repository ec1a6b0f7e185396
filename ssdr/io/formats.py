"""The file formats by suffix, the functions that read and write each, and checks of their options.

A format's modules are imported at its first use.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..common.errors import FormatError, InputError, is_whole
from ..mesh.surface import METRES_Y_UP, UNKNOWN, Space
from .file_errors import check, refuse_device


@dataclasses.dataclass(frozen=True, kw_only=True)
class Format:
    """A file format, as far as it is known before its modules are imported.

    Attributes
    ----------
    title : str
    reader : str
        Module of this package, or class in it (``module:Class``), whose functions read the format:
        `read`, and where the format holds such things `read_skinning`, `list_clips`, `list_meshes`
        and `list_left_out`. The keyword arguments of `read`, `read_skinning` and the writers are
        the options of the format. One with `list_clips` takes `clip` in `read`, and one with
        `list_meshes` takes `meshes`.
    writer : str
        The same for `write_sequence` and `write_skinning`; by default the reader's.
    reads_skinnings : bool
        Whether skinnings and clips can be read; sequences always can.
    writes_sequences, writes_skinnings : bool
    keeps_colors : bool
        Whether vertex colours are written.
    shown : bool
        Whether programs show what it holds, as a surface where there are triangles.
    beside : str or None
        Ending, in place of the suffix, of a file that is written beside one of this format.
    extra : str or None
        Optional dependencies of ssdr that the format needs; None if it needs none.
    space : Space or None
        Space that its files must have.  If its unit or up axis is unknown, a file may choose that;
        None if files cannot state a space.
    """

    title: str
    reader: str
    writer: str = ""
    reads_skinnings: bool = False
    writes_sequences: bool = True
    writes_skinnings: bool = False
    keeps_colors: bool = False
    shown: bool = False
    beside: str | None = None
    extra: str | None = None
    space: Space | None = None

    def function(self, name: str) -> Any:
        """Function of the format's modules, or None where files can hold no such thing."""
        if name == "read_skinning" and not self.reads_skinnings:
            return None
        place = self.writer if self.writer and name.startswith("write") else self.reader
        module, _, scene = place.partition(":")
        found = importlib.import_module(f".{module}", __package__)
        return getattr(getattr(found, scene) if scene else found, name, None)


_NUMBERED = Format(title="numbered OBJ or PLY", reader="meshes.numbered", shown=True)
_GLTF = Format(
    title="glTF 2.0",
    reader="gltf.gltf_reading:GltfFile",
    writer="gltf.gltf_writing",
    reads_skinnings=True,
    writes_sequences=False,
    writes_skinnings=True,
    keeps_colors=True,
    shown=True,
    space=METRES_Y_UP,
)
_USD = Format(
    title="Universal Scene Description",
    reader="usd.usd_reading:StageFile",
    writer="usd.usd_writing",
    reads_skinnings=True,
    writes_skinnings=True,
    keeps_colors=True,
    shown=True,
    extra="usd",
    space=UNKNOWN,
)

FORMATS: Mapping[str, Format] = {
    ".npz": Format(
        title="NumPy archive",
        reader="arrays.npz",
        reads_skinnings=True,
        writes_skinnings=True,
        keeps_colors=True,
        space=UNKNOWN,
    ),
    ".npy": Format(title="NumPy array", reader="arrays.npy", beside=".faces.npy"),
    ".obj": _NUMBERED,
    ".ply": _NUMBERED,
    ".pc2": Format(title="PC2 point cache", reader="pointcache"),
    ".mdd": Format(title="MDD point cache", reader="pointcache"),
    ".glb": _GLTF,
    ".gltf": dataclasses.replace(_GLTF, beside=".bin"),
    ".usd": _USD,
    ".usda": _USD,
    ".usdc": _USD,
    ".abc": Format(
        title="Alembic",
        reader="alembic.alembic_reading:AlembicFile",
        writer="alembic.alembic_writing",
        extra="alembic",
    ),
    ".fbx": dataclasses.replace(
        _GLTF,
        title="FBX",
        reader="fbx.fbx_reading:FbxFile",
        writer="blender.fbx_writing",
        keeps_colors=False,
        extra="fbx",
    ),
}


def as_path(path: Any) -> Path:
    """Path that a caller gives.

    Raises
    ------
    InputError
        If it is no path, or one that no file can have.
    """
    if not isinstance(path, (str, os.PathLike)) or "\0" in (name := str(os.fspath(path))):
        raise InputError("path", "a path", repr(path))
    return Path(name)


def format_of(path: Path) -> Format:
    """Format of a path with one of the suffixes in `FORMATS`.

    Raises
    ------
    FormatError
        If the suffix is another.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        kind = f"the suffix {suffix!r}" if suffix else "a name without suffix"
        raise FormatError(f"{path}: {kind} is none of {', '.join(sorted(FORMATS))}")
    return FORMATS[suffix]


def format_to_write(path: Path, argument: str) -> Format:
    """Format in which a file can be written.

    Raises
    ------
    InputError
        If no format has the suffix, or its files are only read.
    """
    able = sorted(s for s, f in FORMATS.items() if f.writes_sequences or f.writes_skinnings)
    if path.suffix.lower() not in able:
        raise InputError(argument, f"a suffix of {', '.join(able)}", str(path))
    return FORMATS[path.suffix.lower()]


def format_to_read(path: Path) -> Format:
    """Format of a file, or of a folder or pattern of numbered files, that is to be read.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    FormatError
        If the suffix is not in `FORMATS`, or it is a folder, a device, a pipe or a socket.
    """
    many = path.is_dir() or (not path.exists() and any(c in path.name for c in "%*?["))
    if many and FORMATS.get(path.suffix.lower(), _NUMBERED) is _NUMBERED:
        return _NUMBERED
    format_ = format_of(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    check(not path.is_dir(), f"{path}: a folder, not a file")
    refuse_device(path)
    return format_


def check_beside(path: Path) -> None:
    """Raise an InputError if writing `path` would overwrite a companion file that is not its own.

    If `path` exists, so that it is overwritten, the companion is taken to be that of the old file;
    if not, that of another file.

    Raises
    ------
    InputError
        If the companion exists and `path` does not.
    """
    format_ = FORMATS.get(path.suffix.lower())
    beside = path.with_suffix((format_ and format_.beside) or path.suffix)
    if os.path.lexists(beside) and not os.path.lexists(path):
        raise InputError("path", f"a name whose {beside.name} is not taken", str(path))


def check_options(function: Callable[..., Any], title: str, options: Mapping[str, Any]) -> None:
    """Check options before a format's function is called with them.

    Without this check, any text would count as true for an option that is true or false. Other
    values are checked by the function.

    Raises
    ------
    InputError
        If the function does not have an option, or its value has another type.
    """
    known = option_names(function)
    unknown = [name for name in options if name not in known]
    if unknown:
        wanted = f"{', '.join(known) or 'no options'} (for {title}; units and up for all)"
        raise InputError("options", wanted, ", ".join(unknown))
    parameters = inspect.signature(function).parameters
    for name, value in options.items():
        if isinstance(parameters[name].default, bool) and not isinstance(value, (bool, np.bool_)):
            raise InputError(name, "true or false", repr(value))
        if name == "max_bytes" and value is not None and not is_whole(value):
            raise InputError(name, "an integer", repr(value))
        if name == "max_bytes" and value is not None and value <= 0:
            raise InputError(name, "a positive number", value)


def option_names(function: Callable[..., Any] | None) -> list[str]:
    """Names of the keyword arguments of a format's function; empty if it has no such function."""
    if function is None:
        return []
    parameters = inspect.signature(function).parameters.values()
    return [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]
