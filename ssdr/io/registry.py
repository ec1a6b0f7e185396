"""Which module reads and writes which suffix, and what all of them share."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import inspect
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..clips import one_rate
from ..errors import (
    FormatError,
    InputError,
    MissingDependencyError,
    SsdrError,
    is_real,
    is_whole,
)
from ..sequence import MeshSequence

if TYPE_CHECKING:
    from ..skinning import Skinning

__all__ = [
    "FORMATS",
    "Format",
    "SaveReport",
    "bake",
    "call",
    "describe",
    "format_of",
    "format_to_read",
    "is_many",
    "reading",
    "refuse_device",
    "require",
    "seconds",
]


@dataclasses.dataclass(frozen=True, kw_only=True)
class SaveReport:
    """What :func:`ssdr.save` wrote and what the format's own storage cost.

    Attributes
    ----------
    path : Path
        The file; for numbered files, their pattern.
    bytes : int
        Size of all that was written.
    influences : int or None
        Largest number of influences of a vertex in the file; None where the
        file holds no skin weights.
    error : float or None
        sqrt(Σ |d|² / (F V)) between what the file holds and what was given, in
        the mesh's units; None where the file is exact.
    max_error : float or None
        Largest distance of a vertex, likewise.
    between_frames : float or None
        As `error`, midway between frames: the engine's interpolation of the
        bones against the mean of the two frames.  None where no engine
        interpolates.
    note : str
        What else the user should know, in a sentence.
    lost : tuple of str
        What the file that was a template holds and the new one does not.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     report = ssdr.save(ssdr.samples.load("dancer_small"), f"{folder}/dancer.npz")
    ...     report.bytes == report.path.stat().st_size
    True
    """

    path: Path
    bytes: int
    influences: int | None = None
    error: float | None = None
    max_error: float | None = None
    between_frames: float | None = None
    note: str = ""
    lost: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Format:
    """The functions of one suffix: names in ``ssdr.io.<module>``, None where it has none.

    Where there is a `list_clips`, a file may have several, and `read` takes the option `clip`.
    Where there is a `copy`, `write_skinning` takes the option `template`: a file of the format
    passes through, and `template_problem` says of one why it cannot.
    """

    module: str
    title: str
    read: str | None = "read"
    write_sequence: str | None = None
    read_skinning: str | None = None
    write_skinning: str | None = None
    list_clips: str | None = None
    copy: str | None = None
    left_out: str | None = None
    template_problem: str | None = None
    extra: str | None = None


_GLTF = Format(
    "gltf",
    "glTF 2.0",
    read_skinning="read_skinning",
    write_skinning="write_skinning",
    list_clips="list_clips",
    copy="copy",
    left_out="left_out",
    template_problem="template_problem",
)
_NUMBERED = Format("meshes", "numbered meshes")
_USD = Format(
    "usd",
    "Universal Scene Description",
    write_sequence="write_sequence",
    read_skinning="read_skinning",
    write_skinning="write_skinning",
    list_clips="list_clips",
    copy="copy",
    left_out="left_out",
    template_problem="template_problem",
    extra="usd",
)

FORMATS: dict[str, Format] = {
    ".npz": Format(
        "arrays.npz",
        "NumPy archive",
        write_sequence="write_sequence",
        read_skinning="read_skinning",
        write_skinning="write_skinning",
        list_clips="list_clips",
    ),
    ".npy": Format("arrays.npy", "NumPy array", write_sequence="write_sequence"),
    ".zarr": Format(
        "arrays.zarr_store", "zarr store", write_sequence="write_sequence", extra="zarr"
    ),
    ".obj": Format("meshes", "numbered Wavefront OBJ", write_sequence="write_sequence"),
    ".ply": Format("meshes", "numbered PLY", write_sequence="write_sequence"),
    ".off": Format("meshes", "numbered OFF"),
    ".stl": Format("meshes", "numbered STL"),
    ".pc2": Format("pointcache", "PC2 point cache", "read_pc2", "write_pc2"),
    ".mdd": Format("pointcache", "MDD point cache", "read_mdd", "write_mdd"),
    ".csv": Format("tables", "skin weights, CSV", None, write_skinning="write_csv"),
    ".json": Format("tables", "skin weights, JSON", None, write_skinning="write_json"),
    ".glb": _GLTF,
    ".gltf": _GLTF,
    ".usd": _USD,
    ".usda": _USD,
    ".usdc": _USD,
    ".abc": Format("blender", "Alembic", extra="blender"),
    ".fbx": Format(
        "blender",
        "FBX",
        read_skinning="read_skinning",
        write_skinning="write_skinning",
        list_clips="list_clips",
        left_out="left_out",
        extra="blender",
    ),
}


def format_of(path: Path) -> tuple[str, Format]:
    """Suffix and format of a path.

    Raises
    ------
    FormatError
        If the suffix is not in the table.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        kind = f"the suffix {suffix!r}" if suffix else "a name without suffix"
        raise FormatError(f"{path}: {kind} is none of {', '.join(sorted(FORMATS))}")
    return suffix, FORMATS[suffix]


def is_many(path: Path) -> bool:
    """Whether a path stands for a folder of numbered files or a pattern of their names."""
    if path.suffix.lower() == ".zarr":
        return False
    return path.is_dir() or (not path.exists() and any(c in path.name for c in "%*?["))


def format_to_read(path: Path) -> Format:
    """Format of what is to be read, which may be a folder or a pattern of numbered files.

    Raises
    ------
    FormatError
        If the suffix is not in the table.
    """
    stated = FORMATS.get(path.suffix.lower(), _NUMBERED)
    if is_many(path) and stated.module in (_NUMBERED.module, _GLTF.module):
        return _NUMBERED
    return format_of(path)[1]


def call(format_: Format, function: str, *args: Any, **options: Any) -> Any:
    """Call a format's function; options that it does not know are an InputError."""
    target: Callable[..., Any] = getattr(
        importlib.import_module(f".{format_.module}", __package__), function
    )
    parameters = inspect.signature(target).parameters
    if not any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        known = [n for n, p in parameters.items() if p.kind is p.KEYWORD_ONLY]
        unknown = [n for n in options if n not in known]
        if unknown:
            wanted = ", ".join(known) or "no options"
            raise InputError("options", f"{wanted} (for {format_.title})", ", ".join(unknown))
    for name, value in options.items():
        if name in parameters:
            _check_option(name, value, str(parameters[name].annotation))
    return target(*args, **options)


def _check_option(name: str, value: Any, annotation: str) -> None:
    """Whether an option, which may come from a command line, is of the kind that is stated.

    Raises
    ------
    InputError
        If it is not: any text would count as true, and as a number be NumPy's error.
    """
    kind, _, rest = annotation.partition(" | ")
    if rest not in ("", "None") or (value is None and rest):
        return
    number = isinstance(value, float) or is_real(value)
    fits = {"bool": isinstance(value, (bool, np.bool_)), "int": is_whole(value), "float": number}
    words = {"bool": "true or false", "int": "an integer", "float": "a number"}
    if not fits.get(kind, True):
        raise InputError(name, words[kind], repr(value))


def bake(skinning: Skinning) -> MeshSequence:
    """The vertices of a skinning over its frames.

    Raises
    ------
    InputError
        If clips have different frame rates.
    """
    if not one_rate(skinning.clips):
        raise InputError(
            "thing",
            "clips of one frame rate where vertices are stored, which have one; "
            "skinning.select(name) takes one out",
            ", ".join(f"{clip.name} at {clip.fps:g}" for clip in skinning.clips),
        )
    return MeshSequence(
        skinning.skin(),
        skinning.faces,
        skinning.fps,
        name=skinning.name,
        clip=skinning.clips[0].name if len(skinning.clips) == 1 else "",
        surface=skinning.surface,
        vertex_map=skinning.vertex_map,
        validate=False,
    )


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn whatever a parser raises inside the block into a FormatError that names the file.

    An InputError inside is about what the file holds and becomes one too:
    arguments of the caller are checked outside.
    """
    try:
        refuse_device(path)
        yield
    except PermissionError:
        raise
    except FileNotFoundError as error:
        if not path.exists():
            raise
        raise FormatError(f"{path}: {error}") from error
    except InputError as error:
        raise FormatError(f"{path}: {error}") from error
    except FormatError as error:
        if str(path) in str(error):
            raise
        raise FormatError(f"{path}: {error}") from error
    except SsdrError:
        raise
    except MemoryError as error:
        raise FormatError(f"{path}: needs more memory than there is") from error
    except Exception as error:
        # Parsers of hostile bytes raise anything; every one of these means the same.
        what = str(error) or type(error).__name__
        raise FormatError(f"{path}: truncated or damaged ({what})") from error


def refuse_device(path: Path) -> None:
    """Refuse what may never end, before it is opened.

    Raises
    ------
    FormatError
        If a device, a pipe or a socket has that name.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError):  # a pattern, or a name that is found missing later
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise FormatError(f"{path}: a device, a pipe or a socket, not a file")


def seconds(frames: NDArray[np.integer], fps: float) -> NDArray[np.float64]:
    """Times of frames, for formats that hold them as float32.

    Raises
    ------
    InputError
        If the rate is so low that float32 does not.
    """
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        times = np.asarray(frames / np.float64(fps), dtype=np.float64)
    if times.size and not times.max() <= np.finfo(np.float32).max:
        raise InputError("fps", "a rate whose times float32 can hold", f"{fps:g}")
    return times


def require(module: str, extra: str, what: str) -> Any:
    """Import a package that an extra of ssdr brings; errors as of :func:`import_optional`."""
    return import_optional(module, f"ssdr[{extra}]", what)


def import_optional(module: str, requirement: str, what: str) -> Any:
    """Import a package that may be missing.

    Parameters
    ----------
    module : str
    requirement : str
        What brings it, as pip knows it.
    what : str
        What needs it, at the start of the message.

    Raises
    ------
    MissingDependencyError
        If it is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingDependencyError(
            f'{what} needs the package {module}: pip install "{requirement}"'
        ) from error


_MAGIC = (
    (b"PK\x03\x04", "a zip archive such as .npz"),
    (b"PK\x05\x06", "an empty zip archive"),
    (b"\x93NUMPY", "a NumPy .npy array"),
    (b"glTF", "a binary glTF"),
    (b"PXR-USDC", "a binary USD"),
    (b"#usda", "a text USD"),
    (b"POINTCACHE2", "a PC2 point cache"),
    (b"Kaydara FBX", "an FBX file"),
    (b"Ogawa", "an Alembic file"),
    (b"ply", "a PLY file"),
    (b"\x1f\x8b", "gzip data"),
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"\x80", "a Python pickle"),
)


def describe(head: bytes) -> str:
    """What the first bytes of a file look like, for error messages."""
    if not head:
        return "the file is empty"
    for magic, name in _MAGIC:
        if head.startswith(magic):
            return f"it looks like {name}"
    text = all(32 <= b < 127 or b in b"\t\r\n" for b in head)
    return "it looks like text" if text else "its first bytes belong to no format known here"
