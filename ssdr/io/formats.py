"""The file formats by suffix, the functions that read and write each, and checks of their options.

A format's modules are imported at its first use.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import os
import types
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.errors import FormatError, InputError, is_real, is_whole
from ..mesh.clips import Clip
from ..mesh.sequence import MeshSequence
from ..mesh.surface import METRES_Y_UP, UNKNOWN, Space
from .file_errors import refuse_device
from .save_report import SaveReport

if TYPE_CHECKING:
    from ..model.shapes import Skinned


@dataclasses.dataclass(frozen=True, kw_only=True)
class Functions:
    """Functions of a format; None where a file can hold no such thing.

    Keyword arguments of `read`, `read_skinning` and the writers are the format's options. A format
    with `list_clips` takes `clip` in `read`, and one with `list_meshes` takes `meshes`.
    """

    read: Callable[..., MeshSequence]
    read_skinning: Callable[..., Skinned] | None = None
    write_sequence: Callable[..., SaveReport] | None = None
    write_skinning: Callable[..., SaveReport] | None = None
    list_clips: Callable[..., tuple[Clip, ...]] | None = None
    list_meshes: Callable[[Path], tuple[str, ...]] | None = None
    list_left_out: Callable[[Path], tuple[str, ...]] | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Format:
    """A file format, as far as it is known before its modules are imported.

    Attributes
    ----------
    title : str
    functions : callable
        Imports the format's modules and returns its `Functions`.
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
    functions: Callable[[], Functions]
    reads_skinnings: bool = False
    writes_sequences: bool = True
    writes_skinnings: bool = False
    keeps_colors: bool = False
    shown: bool = False
    beside: str | None = None
    extra: str | None = None
    space: Space | None = None


def _npz() -> Functions:
    from .arrays import npz

    return Functions(
        read=npz.read,
        read_skinning=npz.read_skinning,
        write_sequence=npz.write_sequence,
        write_skinning=npz.write_skinning,
        list_clips=npz.list_clips,
    )


def _sequences(name: str) -> Functions:
    """Functions of a module of this package for a format that holds sequences alone."""
    module = importlib.import_module(f".{name}", __package__)
    return Functions(read=module.read, write_sequence=module.write_sequence)


def _scenes(reader: Any, **writers: Callable[..., SaveReport]) -> Functions:
    """Functions of a format for scenes, read by those of a :class:`~ssdr.io.scene_file.SceneFile`.

    `reader` may also be a module with functions of the same names.
    """
    return Functions(
        read=reader.read,
        read_skinning=reader.read_skinning,
        list_clips=reader.list_clips,
        list_meshes=reader.list_meshes,
        list_left_out=reader.list_left_out,
        **writers,
    )


def _gltf() -> Functions:
    from .gltf import gltf_writing as writer
    from .gltf.gltf_reading import GltfFile

    return _scenes(GltfFile, write_skinning=writer.write_skinning)


def _usd() -> Functions:
    from .usd import usd_writing as writer
    from .usd.usd_reading import StageFile

    return _scenes(
        StageFile, write_sequence=writer.write_sequence, write_skinning=writer.write_skinning
    )


def _alembic() -> Functions:
    from .alembic.alembic_reading import AlembicFile
    from .alembic.alembic_writing import write_sequence

    whole = _scenes(AlembicFile, write_sequence=write_sequence)
    return dataclasses.replace(whole, read_skinning=None)


def _fbx() -> Functions:
    from .blender.fbx_writing import write_skinning
    from .fbx.fbx_reading import FbxFile

    return _scenes(FbxFile, write_skinning=write_skinning)


_NUMBERED = Format(
    title="numbered OBJ or PLY", functions=lambda: _sequences("meshes.numbered"), shown=True
)
_ZARR = Format(title="zarr store", functions=lambda: _sequences("arrays.zarr_store"), extra="zarr")
_GLTF = Format(
    title="glTF 2.0",
    functions=_gltf,
    reads_skinnings=True,
    writes_sequences=False,
    writes_skinnings=True,
    keeps_colors=True,
    shown=True,
    space=METRES_Y_UP,
)
_USD = Format(
    title="Universal Scene Description",
    functions=_usd,
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
        functions=_npz,
        reads_skinnings=True,
        writes_skinnings=True,
        keeps_colors=True,
        space=UNKNOWN,
    ),
    ".npy": Format(
        title="NumPy array", functions=lambda: _sequences("arrays.npy"), beside=".faces.npy"
    ),
    ".zarr": _ZARR,
    ".obj": _NUMBERED,
    ".ply": _NUMBERED,
    ".pc2": Format(title="PC2 point cache", functions=lambda: _sequences("pointcache")),
    ".mdd": Format(title="MDD point cache", functions=lambda: _sequences("pointcache")),
    ".glb": _GLTF,
    ".gltf": dataclasses.replace(_GLTF, beside=".bin"),
    ".usd": _USD,
    ".usda": _USD,
    ".usdc": _USD,
    ".abc": Format(title="Alembic", functions=_alembic, extra="alembic"),
    ".fbx": Format(
        title="FBX",
        functions=_fbx,
        reads_skinnings=True,
        writes_sequences=False,
        writes_skinnings=True,
        shown=True,
        extra="fbx",
        space=METRES_Y_UP,
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


def _is_numbered(path: Path) -> bool:
    """Whether a path is a folder of numbered files or a pattern of their names."""
    many = path.is_dir() or (not path.exists() and any(c in path.name for c in "%*?["))
    return many and FORMATS.get(path.suffix.lower(), _NUMBERED) is _NUMBERED


def format_to_read(path: Path) -> Format:
    """Format of a file, or of a folder or pattern of numbered files.

    Raises
    ------
    FormatError
        If the suffix is not in `FORMATS`.
    """
    return _NUMBERED if _is_numbered(path) else format_of(path)


def check_readable(path: Path) -> None:
    """Raise an error unless there is a file, store or set of numbered files to read at a path.

    Raises
    ------
    FileNotFoundError
        If there is none.
    FormatError
        If it is a folder, a device, a pipe or a socket.
    """
    if _is_numbered(path):
        return
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if path.is_dir() and format_of(path) is not _ZARR:
        raise FormatError(f"{path}: a folder, not a file")
    refuse_device(path)


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


_KINDS: dict[Any, tuple[Callable[[Any], bool], str]] = {
    bool: (lambda value: isinstance(value, (bool, np.bool_)), "true or false"),
    int: (is_whole, "an integer"),
    float: (lambda value: isinstance(value, float) or is_real(value), "a number"),
}


def check_options(function: Callable[..., Any], title: str, options: Mapping[str, Any]) -> None:
    """Check options before a format's function is called with them.

    Numbers and flags must have the type of the parameter: without this check, any text would count
    as true for an option that is true or false. Other values are checked by the function.

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
    hints = typing.get_type_hints(function)
    for name, value in options.items():
        hint = hints[name]
        kinds = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
        optional = kinds[1:] == (type(None),)
        fits, words = _KINDS.get(kinds[0], (None, ""))
        if fits is None or len(kinds) > 1 + optional or (optional and value is None):
            continue
        if not fits(value):
            raise InputError(name, words, repr(value))
        if name == "max_bytes" and value <= 0:
            raise InputError(name, "a positive number", value)


def option_names(function: Callable[..., Any] | None) -> list[str]:
    """Names of the keyword arguments of a format's function; empty if it has no such function."""
    if function is None:
        return []
    parameters = inspect.signature(function).parameters.values()
    return [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]
