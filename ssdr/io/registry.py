"""Table of the file formats, and helpers that they share."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import inspect
import logging
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..clips import Clip, one_rate, pick
from ..errors import FormatError, InputError, SsdrError, is_real, is_whole
from ..sequence import MeshSequence
from ..space import METRES_Y_UP, UNKNOWN, Space
from .budget import afford

if TYPE_CHECKING:
    from ..skinning import Skinning


_log = logging.getLogger(__name__)
_BUGS: dict[type[Exception], str] = {
    KeyError: "it has no {}",
    IndexError: "it refers to something that is not there",
    TypeError: "an entry holds another kind of value than the format says",
    AttributeError: "an entry holds another kind of value than the format says",
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class SaveReport:
    """Size of a file that :func:`ssdr.save` wrote, and the error of its format's storage.

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
        Root mean square sqrt(Σ |d|² / (F V)) of the distances |d| between the stored and the given
        vertices, in the units of the latter; None if the file is exact.
    max_error : float or None
        Largest of these distances; None if the file is exact.
    between_frames : float or None
        Root mean square distance of vertices halfway between two frames, where an engine
        interpolates the bones, from the mean of the given vertices in both frames. None if the file
        has no bones that an engine interpolates.
    note : str
        Further information for the user; may be empty.
    lost : tuple of str
        Contents of the template file that the new file does not have.

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
    """A file format, and what its module or folder in this package does.

    Attributes
    ----------
    title : str
    module : str
        Module that exposes the functions; it is imported when the first of them is needed.
    functions : frozenset of str
        Those of ``read``, ``read_skinning``, ``write_sequence`` and ``write_skinning`` that the
        format supports.  With ``list_clips`` a file can hold several clips, and ``read`` takes the
        option `clip`; with ``list_meshes`` it can hold several meshes, and ``read`` takes `meshes`;
        ``template_problem`` returns the reason why a file cannot be a template.
    extra : str or None
        Extra of ssdr that the format needs.
    space : Space or None
        Space that its files must have.  If its unit or up axis is unknown, a file may choose that;
        None if files cannot state a space.
    """

    title: str
    module: str
    functions: frozenset[str]
    extra: str | None = None
    space: Space | None = None

    def has(self, *names: str) -> bool:
        """Whether the format has any of the functions."""
        return not self.functions.isdisjoint(names)

    def function(self, name: str) -> Callable[..., Any]:
        """Import the format's module and return one of its functions."""
        module = importlib.import_module(f".{self.module}", __package__)
        return getattr(module, name)  # type: ignore[no-any-return]


_READ, _CACHE = frozenset({"read"}), frozenset({"read", "write_sequence"})
_READ_ALL = frozenset({"read", "read_skinning", "list_clips"})
_READ_MESHES = _READ_ALL | {"list_meshes"}
_WRITE = frozenset({"write_sequence", "write_skinning"})
_NUMBERED = Format("numbered meshes", "meshes.numbered", _READ)
_GLTF = Format(
    "glTF 2.0",
    "gltf",
    _READ_MESHES | {"write_skinning", "template_problem"},
    space=METRES_Y_UP,
)
_USD = Format(
    "Universal Scene Description",
    "usd",
    _READ_MESHES | _WRITE,
    "usd",
    UNKNOWN,
)

FORMATS: dict[str, Format] = {
    ".npz": Format(
        "NumPy archive",
        "arrays.npz",
        _READ_ALL | _WRITE,
        space=UNKNOWN,
    ),
    ".npy": Format("NumPy array", "arrays.npy", _CACHE),
    ".zarr": Format("zarr store", "arrays.zarr_store", _CACHE, "zarr"),
    ".obj": Format("numbered Wavefront OBJ", "meshes.numbered", _CACHE),
    ".ply": Format("numbered PLY", "meshes.numbered", _CACHE),
    ".pc2": Format("PC2 point cache", "pointcache", _CACHE),
    ".mdd": Format("MDD point cache", "pointcache", _CACHE),
    ".glb": _GLTF,
    ".gltf": _GLTF,
    ".usd": _USD,
    ".usda": _USD,
    ".usdc": _USD,
    ".abc": Format("Alembic", "alembic", _CACHE | {"list_meshes"}, "alembic"),
    ".fbx": Format(
        "FBX",
        "blender",
        _READ_MESHES | {"write_skinning"},
        "blender",
        METRES_Y_UP,
    ),
}


def format_of(path: Path) -> tuple[str, Format]:
    """Suffix and format of a path.

    Raises
    ------
    FormatError
        If the suffix is not in `FORMATS`.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        kind = f"the suffix {suffix!r}" if suffix else "a name without suffix"
        raise FormatError(f"{path}: {kind} is none of {', '.join(sorted(FORMATS))}")
    return suffix, FORMATS[suffix]


def is_many(path: Path) -> bool:
    """Whether a path is a folder of numbered files or a pattern of their names."""
    if path.suffix.lower() == ".zarr":
        return False
    return path.is_dir() or (not path.exists() and any(c in path.name for c in "%*?["))


def format_to_read(path: Path) -> Format:
    """Format by which a file, or a folder or pattern of numbered files, is read.

    Raises
    ------
    FormatError
        If the suffix is not in `FORMATS`.
    """
    stated = FORMATS.get(path.suffix.lower(), _NUMBERED)
    if is_many(path) and stated.module == _NUMBERED.module:
        return _NUMBERED
    return format_of(path)[1]


def call(format_: Format, function: str, *args: Any, **options: Any) -> Any:
    """Call a format's function by its name, after checking the names and types of the options.

    Raises
    ------
    InputError
        If the function does not have an option, or the option's value has another type.
    """
    target = format_.function(function)
    parameters = inspect.signature(target).parameters
    if not any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        known = [n for n, p in parameters.items() if p.kind is p.KEYWORD_ONLY]
        unknown = [n for n in options if n not in known]
        if unknown:
            wanted = ", ".join(known) or "no options"
            which = f"for {format_.title}; units and up for all"
            raise InputError("options", f"{wanted} ({which})", ", ".join(unknown))
    for name, value in options.items():
        if name in parameters:
            _check_option(name, value, str(parameters[name].annotation))
    return target(*args, **options)


def _check_option(name: str, value: Any, annotation: str) -> None:
    """Raise an InputError if a value is not of the annotated type.

    Without this check, any text would count as true for an option that is true or false.
    """
    kind, _, rest = annotation.partition(" | ")
    if rest not in ("", "None") or (value is None and rest):
        return
    number = isinstance(value, float) or is_real(value)
    fits = {"bool": isinstance(value, (bool, np.bool_)), "int": is_whole(value), "float": number}
    words = {"bool": "true or false", "int": "an integer", "float": "a number"}
    if not fits.get(kind, True):
        raise InputError(name, words[kind], repr(value))
    if name == "max_bytes" and value <= 0:
        raise InputError(name, "a positive number", value)


def pick_clip(names: Sequence[str], clip: Any, path: Path) -> int:
    """Index of the clip that a name or index chooses, by :func:`~ssdr.clips.pick`.

    If there are several clips, the log names the chosen one.
    """
    index = pick(names, clip)
    if len(names) > 1:
        _log.info("%s: clip %r of %s", path, names[index], list(names))
    return index


def check_one_rate(clips: Sequence[Clip], where: str) -> None:
    """Raise an InputError, ending with the reason `where`, if clips differ in their frame rates."""
    if not one_rate(clips):
        rates = ", ".join(f"{clip.name} at {clip.fps:g}" for clip in clips)
        raise InputError("thing", f"clips of one frame rate {where}", rates)


def bake(skinning: Skinning) -> MeshSequence:
    """Sequence of a skinning's vertices in every frame.

    Raises
    ------
    InputError
        If clips have different frame rates, or a coordinate overflows.
    """
    from ..normals import corner_normals

    hint = "skinning.select(name) takes one out"
    check_one_rate(skinning.clips, f"where vertices are stored, which have one; {hint}")
    with np.errstate(over="ignore", invalid="ignore"):  # MeshSequence reports these
        frames, surface = skinning.skin(), skinning.surface
    if surface is not None and surface.normals is not None:
        # those of a skinning belong to its rest pose, which need not be a frame
        normals = corner_normals(frames[0], skinning.faces, surface)
        surface = dataclasses.replace(surface, normals=normals)
    return MeshSequence(
        frames,
        skinning.faces,
        skinning.fps,
        name=skinning.name,
        clip=skinning.clips[0].name if len(skinning.clips) == 1 else "",
        surface=surface,
        vertex_map=skinning.vertex_map,
        space=skinning.space,
    )


@contextlib.contextmanager
def reading(path: Path, *options: str) -> Iterator[None]:
    """Turn errors of a parser inside the block into a FormatError that names the file.

    An InputError inside the block becomes a FormatError, too, because it is about the contents of
    the file, unless it is about one of the `options` of the caller. Errors of a missing file,
    permission or package stay as they are.
    """
    try:
        refuse_device(path)
        yield
    except Exception as error:
        missing = isinstance(error, FileNotFoundError) and not path.exists()
        named = isinstance(error, FormatError) and str(error).startswith(str(path))
        of_caller = isinstance(error, InputError) and error.argument in options
        of_no_file = isinstance(error, SsdrError) and not isinstance(error, ValueError)
        kept = of_caller or of_no_file or isinstance(error, (PermissionError, UserWarning))
        if missing or named or kept:
            raise
        what = str(error) or type(error).__name__
        if isinstance(error, MemoryError):
            what = "needs more memory than there is"
        elif not isinstance(error, (FormatError, InputError, FileNotFoundError)):
            # On hostile bytes a parser may raise any error, even one about its own code.
            _log.debug("%s", path, exc_info=error)
            said = [text for kind, text in _BUGS.items() if isinstance(error, kind)]
            what = f"truncated or damaged ({said[0].format(what) if said else what})"
        raise FormatError(f"{path}: {what}") from error


def check(valid: Any, problem: str) -> None:
    """Raise a FormatError with the text `problem` unless `valid` is true."""
    if not valid:
        raise FormatError(problem)


def refuse_device(path: Path) -> None:
    """Raise a FormatError for a device, a pipe or a socket, because reading it may never end.

    Raises
    ------
    FormatError
        If `path` exists and is neither a file nor a folder.
    """
    usual = path.is_file() or path.is_dir() or not path.exists()
    check(usual, f"{path}: a device, a pipe or a socket, not a file")


def read_file(path: Path) -> bytes:
    """Check the size of a file and read all its bytes; to be called inside :func:`reading`."""
    afford(path.stat().st_size, "the whole file", path)
    return path.read_bytes()


def seconds(frames: NDArray[np.integer], fps: float) -> NDArray[np.float64]:
    """Convert frame indices to seconds, and check that float32 can hold the times.

    Raises
    ------
    InputError
        If `fps` is so low that a time exceeds the range of float32.
    """
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        times = np.asarray(frames / np.float64(fps), dtype=np.float64)
    if times.size and not times.max() <= np.finfo(np.float32).max:
        raise InputError("fps", "a rate whose times float32 can hold", f"{fps:g}")
    return times
