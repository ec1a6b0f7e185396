"""Reading of input files and the choice of their clips."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..clips import Clip, unique_names
from ..errors import FormatError, InputError
from ..io.formats import option_names
from ..sequence import MeshSequence, joined
from ..skinning import Skinning
from .format_options import PLACED, readable_format
from .output import Output

_MOST_NAMES = 20  # in a line of the table


def read_any(path: Path, **options: Any) -> MeshSequence | Skinning:
    """Read the skinning of a file, or its sequence if it holds no skinning."""
    from .. import io

    format_ = readable_format(path)
    no_skinning = None
    if format_ is not None and format_.skinnings:
        known = set(option_names(format_.functions().read_skinning))
        try:
            fitting = {k: v for k, v in options.items() if k in known | PLACED}
            return io.load_skinning(path, **fitting)
        except FormatError as error:
            no_skinning = error
    try:
        return io.load(path, **options)
    except FormatError as error:
        raise error from no_skinning


def clips_in(path: Path, options: dict[str, Any]) -> tuple[Clip, ...]:
    """Clips of a file; empty if its format has none or the file does not exist."""
    from ..io import list_clips

    format_ = readable_format(path)
    if format_ is None or not format_.skinnings or not path.exists():
        return ()
    known = option_names(format_.functions().list_clips)
    return list_clips(path, **{k: v for k, v in options.items() if k in known})


def meshes_text(path: Path) -> str:
    """Names of the meshes that are read as one; empty if a file has only one."""
    from ..io import list_meshes

    known = readable_format(path)
    names = list_meshes(path) if known is not None else ()
    if len(names) < 2:
        return ""
    listed = ", ".join(names[:_MOST_NAMES]) + ", ..." * (len(names) > _MOST_NAMES)
    return f"{len(names)}, read as one (--read meshes=NAME takes one): {listed}"


def read_clips(
    paths: Sequence[Path], names: list[str] | None, options: Sequence[dict[str, Any]]
) -> list[MeshSequence]:
    """Read the chosen clips in file order, with unique names, in the first file's space.

    Parameters
    ----------
    paths : paths
    names : list of str or None
        Clips to read; ``all`` reads every clip.  None: the first clip of each file, with a
        warning if the file has others.
    options : dicts
        Arguments of :func:`ssdr.load`, one dict for each file.

    Raises
    ------
    InputError
        If no file has a clip of a name in `names`, a file with several clips has none of these
        names, or the files hold different meshes.
    """
    from ..io import in_space, load

    found: list[tuple[Path, MeshSequence]] = []
    held: list[str] = []
    for path, given in zip(paths, options, strict=True):
        given = {k: v for k, v in given.items() if k != "weld"}
        known = [clip.name for clip in clips_in(path, given)]
        if len(known) < 2:
            shots = [load(path, **given)]
            held.append(shots[0].clip or shots[0].name)
        else:
            held += known
            chosen = _chosen(names, known, path)
            shots = [load(path, clip=name, **given) for name in chosen]
        found += [(path, in_space(shot, (found or [(path, shot)])[0][1].space)) for shot in shots]
    _check_names(names, held)
    _check_one_mesh(found)
    shots = _named(found)
    return _welded(shots) if any(given.get("weld") for given in options) else shots


def read_model(
    path: Path, names: list[str] | None, options: dict[str, Any]
) -> MeshSequence | Skinning:
    """Read a skinning with the named clips, by default all, or a sequence if there is none."""
    thing = read_any(path, **options)
    if isinstance(thing, Skinning):
        _check_names(names, [clip.name for clip in thing.clips])
        every = names is None or "all" in names
        return thing if every else thing.select(*dict.fromkeys(names or ()))
    if names is None and len(clips_in(path, options)) < 2:
        return thing
    return read_vertices(path, names, options)


def read_truth(path: Path, clips: tuple[Clip, ...], options: dict[str, Any]) -> MeshSequence:
    """Read the sequence of the reference, or of its clips named as in `clips` if it has several."""
    several = len(clips_in(path, options)) > 1
    names = [clip.name for clip in clips] if several and clips else None
    return joined(read_clips([path], names, [options]))


def read_vertices(path: Path, names: list[str] | None, options: dict[str, Any]) -> MeshSequence:
    """Read the sequence of one clip of a file, the first clip if none is named."""
    shots = read_clips([path], names, [options])
    if len(shots) > 1:
        known = ", ".join(shot.clip for shot in shots)
        raise InputError("--clip", f"one clip where vertices are read, of {known}", len(shots))
    return shots[0]


def read_pairs(
    paths: tuple[Path, Path], names: list[str] | None, options: Sequence[dict[str, Any]]
) -> list[tuple[str, MeshSequence, MeshSequence]]:
    """Read the clips of two files A and B; return, for each, its name and the sequences of A and B.

    Raises
    ------
    InputError
        If B lacks a clip of A, or the files do not have the same number of clips.
    """
    several = [len(clips_in(path, o)) > 1 for path, o in zip(paths, options, strict=True)]
    sides = []
    for path, given, many in zip(paths, options, several, strict=True):
        # A file with one clip has no choice where the other has several.
        wanted = (names or ["all"]) if many else None if any(several) else names
        sides.append(read_clips([path], wanted, [given]))
    a, b = sides
    if len(a) != len(b):
        clips = [", ".join(shot.clip for shot in side) for side in (a, b)]
        raise InputError("--clip", "as many clips of A as of B", ", and ".join(clips))
    if len(a) > 1:
        by_name = {shot.clip: shot for shot in b}
        for shot in a:
            if shot.clip not in by_name:
                raise InputError("B", f"the clips of A, {shot.clip} too", ", ".join(by_name))
        b = [by_name[shot.clip] for shot in a]
    return [(s.clip, s, t) for s, t in zip(a, b, strict=True)]


def clips_document(clips: Sequence[Clip]) -> list[dict[str, Any]]:
    """Clips as dicts for JSON."""
    return [
        {**dataclasses.asdict(clip), "frames": clip.n_frames, "duration": clip.n_frames / clip.fps}
        for clip in clips
    ]


def clips_text(clips: Sequence[Clip]) -> str:
    """Names, frame counts and frame rates of clips in one line."""
    return ", ".join(f"{c.name or 'unnamed'} ({c.n_frames} at {c.fps:g} a second)" for c in clips)


def _chosen(names: list[str] | None, known: list[str], path: Path) -> list[str]:
    """Names of the clips to read from a file with several clips; `names` are those requested."""
    listed = ", ".join(known)
    if names is None:
        Output.current.warn(
            f"{path} has {len(known)} clips ({listed}): {known[0]} is taken; "
            "--clip NAME takes another, --clip all takes all"
        )
        return known[:1]
    chosen = known if "all" in names else [n for n in dict.fromkeys(names) if n in known]
    if not chosen:
        raise InputError("--clip", f"a clip of {path}: {listed}, or all", names)
    return chosen


def _check_names(names: list[str] | None, held: Collection[str]) -> None:
    for name in names or ():
        if name != "all" and name not in held:
            raise InputError("--clip", f"one of {', '.join(held)}, or all", name)


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
