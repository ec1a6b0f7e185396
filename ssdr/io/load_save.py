"""Load and save files; the suffix chooses the format, whose module is imported at first use."""

from __future__ import annotations

import dataclasses
import logging
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import FormatError, InputError, SsdrWarning, is_real
from ..mesh.clips import Clip, pick
from ..mesh.sequence import MeshSequence, sequence_in
from ..mesh.surface import Space, Up
from .arrays.npy import reads
from .file_clips import bake
from .formats import (
    FORMATS,
    Format,
    as_path,
    check_beside,
    check_options,
    format_to_read,
    format_to_write,
    option_names,
)
from .frame_rates import parse_range
from .references import trusting
from .save_report import SaveReport
from .spaces import ready_to_write, scaled, with_space

if TYPE_CHECKING:
    from ..model.shapes import Skinned


_log = logging.getLogger(__name__)
_BARE = "has no triangles: programs show points or nothing (faces= of what was fitted adds them)"


def load(
    path: str | os.PathLike[str],
    *,
    clip: str | int | None = None,
    weld: bool = False,
    frames: str | tuple[float, float] | None = None,
    fps: float | None = None,
    scale: float = 1.0,
    units: float | None = None,
    up: Up | None = None,
    folder: str | os.PathLike[str] | None = None,
    **options: Any,
) -> MeshSequence:
    """Read an animated mesh; from a file with a skinning, the skinned vertices of every frame.

    One clip is read; :func:`list_clips` lists the clips of a file.

    Parameters
    ----------
    path : path
        A file, a folder of numbered meshes or a pattern of them (``frame_%04d.obj``,
        ``frame_*.ply``).
    clip : str or int, optional
        Name or index of the clip; the first by default. If there are several, the log lists them.
    weld : bool
        Merge vertices that coincide in every frame, as vertices along seams of UVs or normals do.
        `vertex_map` of the result holds the merged vertex of each original one, and the log says
        how many were merged.
    frames : "10:50" or (10, 50), optional
        First and last frame to read, by the file's own numbers: time codes of USD, numbers in the
        names of files, times of glTF, FBX and Alembic multiplied by their rate, else from 0 on.
    fps : float, optional
        Frames per second, in place of the rate in the file. By default the file's rate, or 24 if it
        states none.
    scale : float
        Factor by which all lengths are multiplied. With any other than 1, the unit of the result is
        not known, and all frames are read into memory.
    units : float, optional
        Metres in a unit of the result, in place of what the file states. Coordinates stay as they
        are.
    up : {"y", "z"}, optional
        Up axis of the result, in place of what the file states. Coordinates stay as they are.
    folder : path, optional
        Further folder: files in or below it may be read, too, where this file refers to them. By
        default they must be in or below the folder of this file.
    **options
        Options of the format; the page on formats lists them.

    Returns
    -------
    MeshSequence

    Raises
    ------
    FormatError
        If the suffix is unknown, the file is truncated, hostile or mislabelled, or its contents are
        not valid for a :class:`MeshSequence`.
    InputError
        If the format does not have an option, the value of an option is not valid, or the file has
        no such clip.
    MissingDependencyError
        If the format needs an optional package that is not installed.
    FileNotFoundError
        If there is no such file.

    Examples
    --------
    >>> dancer = ssdr.load(ssdr.samples.path("dancer_small"))
    >>> dancer.vertices.shape, dancer.fps
    ((24, 799, 3), 8.0)
    """
    source, format_ = _to_read(path, fps, scale)
    space, read = Space(units, up), format_.function("read")
    names = option_names(read)
    if "clip" in names and clip is not None:
        options["clip"] = clip
    wanted, own = parse_range(frames), "frames" in names
    options |= {"frames": wanted} if own else {}
    check_options(read, format_.title, options)
    with trusting(folder):
        if not reads(options.get("faces")):  # a scene that holds the mesh
            options["faces"] = load(options["faces"])
        sequence: MeshSequence = read(source, fps=fps, **options)
    if "clip" not in names:
        pick([_only_clip(sequence, source).name], clip)
    if wanted is not None and not own:
        part = _only_clip(sequence, source).part(*wanted)
        kept = sequence.vertices[part.frames]
        sequence = dataclasses.replace(sequence, vertices=kept, validate=False)
    sequence = scaled(sequence, scale, space)
    if weld:
        sequence, report = sequence.weld()
        numbers = dataclasses.astuple(report)
        _log.info("%s: welded %d vertices to %d (tolerance %.3g)", source, *numbers)
    return sequence


def list_clips(
    path: str | os.PathLike[str],
    *,
    fps: float | None = None,
    folder: str | os.PathLike[str] | None = None,
    **options: Any,
) -> tuple[Clip, ...]:
    """Clips of a file, with frames numbered as in the result of :func:`load_skinning`.

    If a format has no clips, a file counts as one clip, named after its animation, mesh or file.

    Parameters
    ----------
    path, fps, folder, **options
        As in :func:`load`.

    Raises
    ------
    FormatError, InputError, MissingDependencyError, FileNotFoundError
        As in :func:`load`.

    Examples
    --------
    >>> ssdr.list_clips(ssdr.samples.path("dancer_small"))
    (Clip(name='dancer_small', start=0, stop=24, fps=8.0),)
    """
    source, format_ = _to_read(path, fps)
    listed = format_.function("list_clips")
    if listed is None:
        return (_only_clip(load(source, fps=fps, folder=folder, **options), source),)
    check_options(listed, format_.title, options)
    with trusting(folder):
        return tuple(listed(source, fps=fps, **options))


def list_meshes(
    path: str | os.PathLike[str], *, folder: str | os.PathLike[str] | None = None
) -> tuple[str, ...]:
    """Names of the meshes that a file shows, in the order in which reading joins them to one.

    They are what the option ``meshes=`` of :func:`load` and :func:`load_skinning` takes. The list
    is empty for formats that give meshes no names.

    Parameters
    ----------
    path : path
        File of any format that :func:`load` reads.
    folder : path, optional
        As in :func:`load`, for a file that is made of several.

    Raises
    ------
    FormatError, FileNotFoundError
        If there is no such file, or it is damaged or of no format that is read.
    InputError, MissingDependencyError
        As in :func:`load`.

    Examples
    --------
    >>> import tempfile
    >>> start = ssdr.initialize(ssdr.samples.load("dancer_small"), bones=4)
    >>> with tempfile.TemporaryDirectory() as place:
    ...     _ = ssdr.save(start, f"{place}/dance.glb")
    ...     ssdr.io.list_meshes(f"{place}/dance.glb")
    ('dancer_small',)
    """
    return _listed("list_meshes", path, folder)


def list_left_out(
    path: str | os.PathLike[str], *, folder: str | os.PathLike[str] | None = None
) -> tuple[str, ...]:
    """Contents of a scene that no function here reads, each with its number or its name.

    These are lights, cameras, curves, extensions, meshes that are never shown and the like, as
    "2 lights". Files of the other formats hold meshes alone, and nothing is left out of them.

    Parameters
    ----------
    path : path
        A scene: glTF, USD, FBX or Alembic.
    folder : path, optional
        Where else than beside the scene its layers and buffers may lie.

    Raises
    ------
    FormatError, InputError, MissingDependencyError, FileNotFoundError
        As in :func:`list_meshes`.

    Examples
    --------
    >>> ssdr.io.list_left_out(ssdr.samples.path("dancer_small"))
    ()
    """
    return _listed("list_left_out", path, folder)


def _listed(name: str, path: Any, folder: Any) -> tuple[str, ...]:
    """What a function of a file's format lists; nothing if the format has no such function."""
    source, format_ = _to_read(path)
    listed = format_.function(name)
    with trusting(folder):
        return () if listed is None else tuple(listed(source))


def _to_read(
    path: Any, fps: float | None = None, scale: float = 1.0, *, skinning: bool = False
) -> tuple[Path, Format]:
    """Checked path of a file to read, and its format.

    If `skinning` is true, the format must be one that holds skinnings.
    """
    for argument, value in (("fps", fps), ("scale", scale)):
        if value is not None and not (is_real(value) and value > 0):
            raise InputError(argument, "a positive number", repr(value))
    source = as_path(path)
    format_ = format_to_read(source)
    if skinning and not format_.reads_skinnings:
        able = ", ".join(sorted(suffix for suffix, f in FORMATS.items() if f.reads_skinnings))
        wrong = f"no skinning can be read from {source.suffix}, only from {able}"
        raise FormatError(f"{source}: {wrong}")
    return source, format_


def _only_clip(sequence: MeshSequence, source: Path) -> Clip:
    name = sequence.clip or sequence.name or source.stem
    return Clip(name, 0, len(sequence), sequence.fps)


def load_skinning(
    path: str | os.PathLike[str],
    *,
    clip: str | int | Sequence[str | int] | None = None,
    frames: str | tuple[float, float] | None = None,
    fps: float | None = None,
    scale: float = 1.0,
    units: float | None = None,
    up: Up | None = None,
    folder: str | os.PathLike[str] | None = None,
    **options: Any,
) -> Skinned:
    """Read a skinning: rest pose, skin weights and bone transforms.

    Parameters
    ----------
    path : path
        ``.npz``, ``.glb``, ``.gltf``, ``.fbx`` or USD.
    clip : str, int or several of them, optional
        Names or indices of the clips to read; all by default.
    frames : "10:50" or (10, 50), optional
        First and last frame of every clip, as in :func:`load`.
    fps : float, optional
        Frames per second of every clip, as in :func:`load`.
    scale : float
        Factor by which all lengths are multiplied: positions of vertices and joints, and
        translations of the bones.
    units, up, folder
        As in :func:`load`.

    Returns
    -------
    Skinning, or ShapedSkinning if the file has morph targets or blend shapes

    Raises
    ------
    FormatError
        If no skinning can be read from the format, the file holds none, or the file is damaged.
    InputError, MissingDependencyError, FileNotFoundError
        As in :func:`load`.

    Examples
    --------
    >>> import tempfile
    >>> start = ssdr.initialize(ssdr.samples.load("dancer_small"), bones=4)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     report = ssdr.save(start, f"{folder}/dancer.npz")
    ...     again = ssdr.load_skinning(report.path)
    >>> again.n_bones
    4
    """
    source, format_ = _to_read(path, fps, scale, skinning=True)
    space, read = Space(units, up), format_.function("read_skinning")
    wanted, own = parse_range(frames), "frames" in option_names(read)
    options |= {"frames": wanted} if own else {}
    check_options(read, format_.title, options)
    with trusting(folder):
        skinning: Skinned = scaled(read(source, fps=fps, **options), scale, space)
    if wanted is not None and not own:
        skinning = skinning.select(*range(len(skinning.clips)), between=wanted)
    if clip is None:
        return skinning
    return skinning.select(*([clip] if isinstance(clip, (str, int)) else clip))


def save(
    thing: Any,
    path: str | os.PathLike[str],
    *,
    units: float | None = None,
    up: Up | None = None,
    folder: str | os.PathLike[str] | None = None,
    **options: Any,
) -> SaveReport:
    """Write a sequence or a skinning to a file.

    It is converted to metres with y up for glTF and FBX. The note of the report says what was
    converted and what is not known.

    A file that exists is overwritten. If writing stops with an error, the old file stays, and no
    incomplete one is left. If the format cannot hold a skinning, its skinned vertices are written,
    with the frames of all clips one after the other.

    Parameters
    ----------
    thing : MeshSequence, Skinning, ShapedSkinning, a result, or meshes of trimesh
        Of a result, such as a Decomposition, the model is written.
    path : path
        File to write, whose suffix chooses the format. For numbered meshes, a pattern such as
        ``folder/frame_%04d.obj``.
    units : float, optional
        Metres in a unit of `thing`, in place of those that ``thing.space`` states.
    up : {"y", "z"}, optional
        Up axis of `thing`, in place of that of ``thing.space``.
    folder : path, optional
        As in :func:`load`, for a template.
    **options
        Options of the format; the page on formats lists them.

    Returns
    -------
    SaveReport

    Raises
    ------
    InputError
        If `thing` cannot be written in that format, the format does not have an option, or a file
        that another one needs would be overwritten, as the ``.bin`` of a ``.gltf``.
    MissingDependencyError
        If the format needs an optional package that is not installed.

    Examples
    --------
    >>> import tempfile
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     report = ssdr.save(dancer, f"{folder}/dancer.npz")
    ...     again = ssdr.load(report.path)
    >>> np.array_equal(again.vertices, dancer.vertices)
    True
    """
    from ..model.shapes import ShapedSkinning, Skinned
    from ..model.skinning import Skinning, skinning_in

    target = as_path(path)
    format_ = format_to_write(target, "path")
    check_beside(target)
    thing = sequence_in(skinning_in(thing))
    if not isinstance(thing, (MeshSequence, Skinning, ShapedSkinning)):
        raise InputError("thing", "a MeshSequence, Skinning or Decomposition", type(thing).__name__)
    if not (format_.writes_sequences or isinstance(thing, Skinned)):
        able = ", ".join(sorted(suffix for suffix, f in FORMATS.items() if f.writes_sequences))
        raise InputError("path", f"a suffix of {able} for a MeshSequence", target.suffix)
    notes: list[str] = []
    rigged = isinstance(thing, Skinned) and format_.writes_skinnings
    write = format_.function("write_skinning" if rigged else "write_sequence")
    check_options(write, format_.title, options)
    if isinstance(thing, Skinned) and not rigged:
        if len(thing.clips) > 1:
            names = ", ".join(f"{c.name} from frame {c.start}" for c in thing.clips)
            notes.append(f"clips are not kept apart: {names}")
        thing = bake(thing)
    given = with_space(thing, thing.space.but(Space(units, up)))
    ready, said = ready_to_write(given, format_.title, format_.space)
    with trusting(folder):
        report: SaveReport = write(ready, target, **options)
    if report.lost:
        warnings.warn(f"{target}: not kept: {', '.join(report.lost)}", SsdrWarning, stacklevel=2)
    if getattr(thing.surface, "colors", None) is not None and not format_.keeps_colors:
        notes.append("vertex colours are not kept")
    bare = format_.shown and not len(thing.faces)
    notes = [*([_BARE] if bare else []), *([said] if said else []), *report.notes, *notes]
    back = (ready.space.units or 1.0) / (given.space.units or ready.space.units or 1.0)
    between = report.between_frames
    return dataclasses.replace(
        report,
        error=report.error * back,
        max_error=report.max_error * back,
        between_frames=None if between is None else between * back,
        notes=tuple(notes),
    )
