"""Files read together: the clips of one mesh, and files that may hold a skinning or not."""

from __future__ import annotations

import dataclasses
import inspect
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.errors import FormatError, InputError, SsdrWarning, check_flag
from ..mesh.clips import unique_names
from ..mesh.sequence import MeshSequence, joined
from .formats import as_path, format_to_read, option_names
from .load_save import list_clips, load, load_skinning
from .spaces import in_space

if TYPE_CHECKING:
    from ..model.shapes import Skinned

Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


def load_clips(
    paths: Paths, *, clip: str | Sequence[str] | None = None, weld: bool = False, **options: Any
) -> list[MeshSequence]:
    """Read clips of one mesh, from one file or from several, for one model of all of them.

    The result can be given to :func:`decompose`. Clips come in the order of the files. Their names
    are unique: one that occurs more than once becomes the name of its file. All are converted to
    the space of the first.

    Parameters
    ----------
    paths : path or sequence of paths
        Files of the same mesh.
    clip : str or sequence of str, optional
        Names of the clips to read, or "all". By default the first of each file, with a warning if
        there are others.
    weld : bool
        Merge vertices that coincide in every frame of every clip.
    **options
        Other options of :func:`load`, for the files whose format has them.

    Returns
    -------
    list of MeshSequence

    Raises
    ------
    InputError
        If a clip does not exist, the files hold different meshes, or none of them has an option.
    FormatError, MissingDependencyError, FileNotFoundError
        As in :func:`load`.

    Warns
    -----
    SsdrWarning
        If a file has several clips and `clip` does not say which to read.

    Examples
    --------
    >>> import tempfile
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = [ssdr.save(dancer, f"{folder}/{name}.npz").path for name in ("a", "b")]
    ...     clips = ssdr.load_clips(files)
    >>> [clip.clip for clip in clips]
    ['a', 'b']
    """
    files = [as_path(p) for p in ([paths] if isinstance(paths, (str, os.PathLike)) else paths)]
    names = [clip] if isinstance(clip, str) else clip
    check_flag(weld, "weld")
    found: list[tuple[Path, MeshSequence]] = []
    held: list[str] = []
    for path, given in zip(files, _for_each(files, options), strict=True):
        known = clips_in(path, **given)
        if len(known) < 2:
            shots = [load(path, **given)]
            held.append(shots[0].clip or shots[0].name)
        else:
            held += known
            shots = [load(path, clip=name, **given) for name in _chosen(names, known, path)]
        found += [(path, in_space(shot, (found or [(path, shot)])[0][1].space)) for shot in shots]
    _check_names(names, held)
    _check_one_mesh(found)
    shots = _named(found)
    return _welded(shots) if weld else shots


def load_any(
    path: str | os.PathLike[str], *, clip: str | Sequence[str] | None = None, **options: Any
) -> MeshSequence | Skinned:
    """Read the skinning of a file or, if it holds none, the sequence of one clip.

    Parameters
    ----------
    path : path
    clip : str or sequence of str, optional
        Names of the clips of a skinning; all by default. Of a sequence, the name of one clip; the
        first by default.
    **options
        Other options of :func:`load`.

    Raises
    ------
    InputError
        If a clip does not exist, or there are several of a sequence.
    FormatError, MissingDependencyError, FileNotFoundError
        As in :func:`load`.

    Examples
    --------
    >>> ssdr.io.load_any(ssdr.samples.path("dancer_small"))
    MeshSequence('dancer_small', F=24, V=799, T=1586, fps=8, float32)
    """
    names = [clip] if isinstance(clip, str) else clip
    try:
        model = load_skinning(path, **options)
    except FormatError as no_skinning:
        try:
            shots = load_clips(path, clip=names, **options)
        except FormatError as error:
            raise error from no_skinning
        if len(shots) > 1:
            known = ", ".join(shot.clip for shot in shots)
            raise InputError(
                "clip", f"one where vertices are read, of {known}", len(shots)
            ) from None
        return shots[0]
    _check_names(names, [one.name for one in model.clips])
    every = names is None or "all" in names
    return model if every else model.select(*dict.fromkeys(names or ()))


def clips_in(path: Path, **options: Any) -> list[str]:
    """Names of a file's clips; none if its format has no clips."""
    if not format_to_read(path).reads_skinnings:
        return []
    known = {k: v for k, v in options.items() if k in ("fps", "folder")}
    return [clip.name for clip in list_clips(path, **known)]


def _for_each(files: Sequence[Path], options: dict[str, Any]) -> list[dict[str, Any]]:
    """Options of each file: those of :func:`load`, and those that its format has."""
    general = inspect.signature(load).parameters.keys()
    known = [general | option_names(format_to_read(path).function("read")) for path in files]
    for name in options:
        if len(files) > 1 and not any(name in one for one in known):
            wanted = ", ".join(sorted(set().union(*known) - {"path", "options", "clip"}))
            raise InputError("options", wanted, name)
    if len(files) == 1:  # whose reader says what it has
        return [options]
    return [{k: v for k, v in options.items() if k in one} for one in known]


def _chosen(names: Sequence[str] | None, known: list[str], path: Path) -> list[str]:
    """Names of the clips to read from a file with several clips; `names` are those requested."""
    listed = ", ".join(known)
    if names is None:
        said = f"{path} has {len(known)} clips ({listed}): {known[0]} is taken"
        warnings.warn(f"{said}; clip= names others, or all", SsdrWarning, stacklevel=3)
        return known[:1]
    chosen = known if "all" in names else [n for n in dict.fromkeys(names) if n in known]
    if not chosen:
        raise InputError("clip", f"a clip of {path}: {listed}, or all", ", ".join(names))
    return chosen


def _check_names(names: Sequence[str] | None, held: Sequence[str]) -> None:
    for name in names or ():
        if name != "all" and name not in held:
            raise InputError("clip", f"one of {', '.join(held)}, or all", name)


def _check_one_mesh(found: list[tuple[Path, MeshSequence]]) -> None:
    first_path, first = found[0]
    for path, shot in found[1:]:
        if shot.n_vertices != first.n_vertices:
            expected = f"the {first.n_vertices:,} vertices of {first_path}"
            raise InputError(str(path), expected, f"{shot.n_vertices:,}")
        if not np.array_equal(shot.faces, first.faces):
            raise InputError(str(path), f"the triangles of {first_path}", "others")


def _named(found: list[tuple[Path, MeshSequence]]) -> list[MeshSequence]:
    """Copies of the sequences with unique clip names.

    A name used more than once is replaced by the stem of its file's name, or by ``stem_name`` if
    several clips come from that file.  A suffix distinguishes names that still agree.
    """
    own = [shot.clip or shot.name for _, shot in found]
    files = [path for path, _ in found]
    names = [
        name if own.count(name) == 1 else path.stem + f"_{name}" * (files.count(path) > 1)
        for path, name in zip(files, own, strict=True)
    ]
    names = list(unique_names(names, "clip")) if len(names) > 1 else names
    return [
        dataclasses.replace(shot, clip=name, validate=False)
        for (_, shot), name in zip(found, names, strict=True)
    ]


def _welded(shots: list[MeshSequence]) -> list[MeshSequence]:
    """Copies in which vertices that coincide in every frame of every clip are merged."""
    whole, _ = joined(shots).weld()
    parts = np.split(whole.vertices, np.cumsum([len(shot) for shot in shots[:-1]]))
    own = [{name: getattr(shot, name) for name in ("fps", "name", "clip")} for shot in shots]
    return [
        dataclasses.replace(whole, vertices=part, validate=False, **names)
        for part, names in zip(parts, own, strict=True)
    ]
