"""One model written to several files: checked before the work, kept if a file fails after it."""

from __future__ import annotations

import contextlib
import os
import tempfile
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from ..common.errors import InputError, MissingDependencyError, SsdrWarning, error_text
from ..mesh.sequence import MeshSequence
from .atomic import check_writable
from .formats import FORMATS, as_path, check_beside, format_of, format_to_write, option_names
from .load_save import list_clips, save
from .optional import PACKAGES, require
from .save_report import SaveReport


def check_outputs(
    paths: Iterable[str | os.PathLike[str]],
    *,
    inputs: Iterable[str | os.PathLike[str]] = (),
    **options: Any,
) -> None:
    """Raise an error before long work if a model could not be written to files after it.

    Parameters
    ----------
    paths : paths
        Files to which :func:`save_all` is to write.
    inputs : paths
        Files that must not be overwritten.
    **options
        As for :func:`save_all`.

    Raises
    ------
    InputError
        If a suffix is unknown, no format has an option, or a file is named twice, is an input,
        lies in a folder that cannot be written to or would overwrite a companion file that is not
        its own.
    MissingDependencyError
        If a format needs a package that is not installed.

    Examples
    --------
    >>> ssdr.io.check_outputs(["horse.glb", "horse.npz"], inputs=["gallop.npz"])
    """
    seen, files = [as_path(path) for path in inputs], [as_path(path) for path in paths]
    for path in files:
        format_ = format_to_write(path, "output")
        if format_ is FORMATS[".fbx"]:
            from .blender import finder

            try:
                finder.command("")
            except MissingDependencyError as error:
                raise MissingDependencyError(f"{path}: FBX needs Blender. {error}") from error
        if format_.extra in PACKAGES:
            require(format_.extra, f"{path}: {format_.title}")
        check_file(path, "output", others=seen)
        seen.append(path)
    _known_options(files, options)


def check_file(path: Path, argument: str, *, others: Iterable[Path]) -> None:
    """Raise an InputError if a file is in `others` or cannot be written.

    The folder of numbered files may be missing, because it is made with them.
    """
    numbered = "%" in path.name and FORMATS.get(path.suffix.lower()) is FORMATS[".obj"]
    try:
        check_beside(path)
        check_writable(path.parent if numbered and not path.parent.exists() else path)
    except InputError as error:
        raise InputError(argument, error.expected, error.got) from error
    if path.resolve() in [other.resolve() for other in others]:
        raise InputError(argument, "a file that is no input and no other output", str(path))


def save_all(
    thing: Any,
    paths: Iterable[str | os.PathLike[str]],
    *,
    templates: Iterable[str | os.PathLike[str]] = (),
    **options: Any,
) -> list[SaveReport]:
    """Write a model to several files; if one cannot be written, the others still are.

    If then no file holds the model, it is written as ``.npz`` to the folder of the first file that
    failed or, if that is not possible either, to the folder for temporary files.

    Parameters
    ----------
    thing : Skinning or Decomposition
    paths : paths
    templates : paths
        Files that the mesh came from. A glTF file keeps all but the mesh's skin of the first one
        that is glTF, too.
    **options
        Options of :func:`save`, for the files whose format has them.

    Returns
    -------
    list of SaveReport

    Raises
    ------
    SsdrError, OSError
        The error of the first file that could not be written, raised at the end.

    Warns
    -----
    SsdrWarning
        Where the model is kept, if no file could be written.

    Examples
    --------
    >>> import tempfile
    >>> start = ssdr.initialize(ssdr.samples.load("dancer_small"), bones=4)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     reports = ssdr.io.save_all(start, [f"{folder}/a.glb", f"{folder}/a.npz"])
    >>> [report.path.name for report in reports]
    ['a.glb', 'a.npz']
    """
    from ..model.skinning import skinning_in

    files, model = list(map(as_path, paths)), skinning_in(thing)
    reports: list[SaveReport] = []
    failed: list[tuple[Path, Exception]] = []
    for path, given in zip(files, _settings(model, files, templates, **options), strict=True):
        try:
            reports.append(save(model, path, **given))
        except Exception as error:
            failed.append((path, error))
    if not failed:
        return reports
    said = [f"{path}: {error_text(other)}" for path, other in failed[1:]]
    if not any(format_of(report.path).writes_skinnings for report in reports):
        kept = _save_beside(model, failed[0][0])
        said.append(f"the model is kept in {kept}" if kept else "the model is lost")
    for text in said:
        warnings.warn(text, SsdrWarning, stacklevel=2)
    raise failed[0][1]


def _save_beside(model: Any, path: Path) -> Path | None:
    """Save a model to the folder of an output that could not be written; return the new file.

    If that fails, the folder for temporary files is used.  If that fails, too, None is returned.
    """
    for folder in (path.parent, None):
        with contextlib.suppress(Exception):
            place = Path(folder or tempfile.gettempdir()) / f"{path.stem[:100]}.rescued.npz"
            if os.path.lexists(place):
                place = place.with_suffix(f".{os.getpid()}.npz")
            save(model, place)
            return place
    return None


def _settings(
    model: Any,
    files: Sequence[Path],
    templates: Iterable[str | os.PathLike[str]] = (),
    **options: Any,
) -> list[dict[str, Any]]:
    """Options of :func:`save` for each file: those that its format has, and a template."""
    known = _known_options(files, options, skinned=not isinstance(model, MeshSequence))
    sources = [as_path(path) for path in templates]
    found = []
    for path, names in zip(files, known, strict=True):
        given = {k: v for k, v in options.items() if k in names}
        source = None
        if "template" in names:
            source = options.get("template") or _template(path, sources)
        if source is not None:
            new = _new_names(source, [clip.name for clip in model.clips])
            given |= {"template": source, **({"clip_names": new} if new else {})}
        else:
            given.pop("meshes", None)  # those of a template
        found.append(given)
    return found


def _known_options(
    files: Sequence[Path], options: Iterable[str], *, skinned: bool = True
) -> list[list[str]]:
    """Names of each format's options; an InputError for one of `options` that no format has."""
    known = []
    for path in files:
        write = format_of(path).function("write_skinning") if skinned else None
        known.append(option_names(write or format_of(path).function("write_sequence")))
    for name in options:
        if name not in ("meshes", "templates") and not any(name in one for one in known):
            wanted = ", ".join(sorted(set().union(*known))) or "no options"
            raise InputError("options", f"one of {wanted}", name)
    return known


def _template(target: Path, sources: Sequence[Path]) -> Path | None:
    """First file that can be the template of a glTF file, or None if there is none."""
    from .gltf.gltf_template import template_problem

    for source in sources:
        known = FORMATS.get(source.suffix.lower())
        if known and known.title == format_of(target).title and source.is_file():
            problem = template_problem(source)
            if not problem:
                return source
            said = f"{target} is written anew: {source}: {problem}"
            warnings.warn(said, SsdrWarning, stacklevel=4)
    return None


def _new_names(source: str | os.PathLike[str], clips: Sequence[str]) -> dict[str, str | None]:
    """Dict from the name of a clip in the file to its name in the model, where these differ.

    None stands for a clip that was not read.
    """
    names: dict[str, str | None] = {}
    for clip in list_clips(source):
        stem = as_path(source).stem
        candidates = (clip.name, stem, f"{stem}_{clip.name}")
        names[clip.name] = next((name for name in candidates if name in clips), None)
    return {old: new for old, new in names.items() if old != new}
