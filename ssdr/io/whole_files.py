"""Copies of files with all contents, and lists of what is not read from a file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

from ..errors import InputError
from .paths import as_path, readable_path
from .references import trusting
from .registry import FORMATS, SaveReport, call, format_of


def copy(
    path: str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    clips: Sequence[str | int] | None = None,
) -> SaveReport:
    """Copy a glTF or USD file with all its contents, also to another suffix of its format.

    Parameters
    ----------
    path : path
        File to copy.
    target : path
        File to write.
    clips : names or indices, optional
        Clips to keep; all by default.

    Raises
    ------
    InputError
        If `path` is not glTF or USD, `target` is of another format, or there is no such clip.
    FormatError, MissingDependencyError, FileNotFoundError
        As in :func:`load`.

    Examples
    --------
    >>> import tempfile
    >>> start = ssdr.initialize(ssdr.samples.load("dancer_small"), bones=4)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = ssdr.save(start, f"{folder}/dance.glb")
    ...     ssdr.io.copy(f"{folder}/dance.glb", f"{folder}/dance.gltf").lost
    ()
    """
    (source, format_), to = readable_path(path), as_path(target)
    if not format_.has("copy") or format_of(to)[1] is not format_:
        raise InputError("target", f"a file of the format of {source}", str(to))
    report: SaveReport = call(format_, "copy", source, to, clips=clips)
    return report


def left_out(path: str | os.PathLike[str], **options: Any) -> tuple[str, ...]:
    """Phrases that name what is not read from a file.

    These are the contents that neither :func:`load` nor :func:`load_skinning` reads. Only files of
    glTF, USD and FBX have any; for other formats the result is empty.

    Parameters
    ----------
    path : path
    **options
        Options given to :func:`load`; only `meshes` and `folder` are used.

    Examples
    --------
    >>> import tempfile
    >>> start = ssdr.initialize(ssdr.samples.load("dancer_small"), bones=4)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = ssdr.save(start, f"{folder}/dance.glb")
    ...     ssdr.io.left_out(f"{folder}/dance.glb")
    ()
    """
    source = as_path(path)
    format_ = FORMATS.get(source.suffix.lower())
    if format_ is None or not format_.has("left_out"):
        return ()
    chosen = {k: v for k, v in options.items() if k == "meshes"}
    with trusting(options.get("folder")):
        found: tuple[str, ...] = call(format_, "left_out", source, **chosen)
    return found
