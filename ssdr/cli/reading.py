"""What commands read: options for each of several files, and the clips in them."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from ..clips import Clip, unique_names
from ..errors import FormatError, InputError
from ..io.registry import Format, format_of, format_to_read
from ..sequence import MeshSequence
from ..skinning import Skinning
from .output import Output, _keywords, _pair, read_any, read_options

ClipNames = Annotated[
    list[str] | None,
    typer.Option("--clip", metavar="NAME", help="Clip to read; repeat it, or say all."),
]
_PREFIX = re.compile(r"\.?(\w+):(?=\w+=)")


def options_for(
    paths: Sequence[Path],
    pairs: list[str] | None,
    *,
    fps: float | None = None,
    weld: bool = False,
    scale: float | None = None,
    roles: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """Keyword arguments of :func:`ssdr.load` for each file.

    ``key=value`` goes to the files whose format knows the key, ``suffix:key=value`` to those of
    that suffix, ``A:key=value`` to the one that has this role.

    Raises
    ------
    InputError
        If no file knows a key, or none is meant by what stands before the colon.
    """
    known = [_known(path) for path in paths]
    result = [read_options(None, fps=fps, weld=weld, scale=scale) for _ in paths]
    for pair in pairs or ():
        match = _PREFIX.match(pair)
        key, value = _pair("--read", pair[match.end() :] if match else pair)
        meant = list(range(len(paths)))
        if match:
            suffix = f".{match[1].lower()}"
            meant = [
                k
                for k, path in enumerate(paths)
                if match[1] in roles[k : k + 1] or path.suffix.lower() == suffix
            ]
            if not meant:
                before = ", ".join([*roles, "the suffix of an input"])
                raise InputError("--read", f"{before} before the colon", pair)
        takers = [k for k in meant if known[k] is None or key in (known[k] or ())]
        if not takers:
            wanted = sorted(set().union(*(known[k] or () for k in meant)))
            files = ", ".join(str(paths[k]) for k in meant)
            raise InputError("--read", f"one of {', '.join(wanted)} for {files}", key)
        for k in takers:
            result[k][key] = value
    return result


def _format(path: Path) -> Format | None:
    try:
        return format_to_read(path)
    except FormatError:
        return None


def _known(path: Path) -> set[str] | None:
    """Options of a file's format; None where it takes any, or there is no such format."""
    format_ = _format(path)
    if format_ is None or format_.read is None:
        return None
    names = {"fps", "weld"}
    for function in (format_.read, format_.read_skinning):
        found = _keywords(format_, function) if function else {"no options"}
        if not found:
            return None
        names |= found - {"no options", "clip"}
    return names


def clips_in(path: Path, options: dict[str, Any]) -> tuple[Clip, ...] | None:
    """The clips of a file; None where its format has none, so that it is one."""
    from ..io import list_clips

    format_ = _format(path)
    if format_ is None or format_.list_clips is None or not path.exists():
        return None
    target = _keywords(format_, format_.list_clips)
    return list_clips(path, **{k: v for k, v in options.items() if k in target})


def wanted_of(names: list[str] | None) -> list[str] | None:
    """Names of ``--clip``, each once; none of them: all clips.  None: nothing was said."""
    if names is None or "all" in names:
        return None if names is None else []
    return list(dict.fromkeys(names))


def read_clips(
    paths: Sequence[Path], names: list[str] | None, options: Sequence[dict[str, Any]]
) -> list[MeshSequence]:
    """A sequence a clip, files and clips in their order, under names that differ.

    Parameters
    ----------
    paths : paths
    names : list of str or None
        Clips to read, ``all`` for every one.  None: of each file the first, with a warning where
        there are others.
    options : dicts
        Of :func:`ssdr.load`, one for each file.

    Raises
    ------
    InputError
        If no file has a clip of that name, none is chosen of a file that has several, or the
        files do not hold one mesh.
    """
    from ..io import load

    names = wanted_of(names)
    found: list[tuple[Path, MeshSequence]] = []
    held: set[str] = set()
    for path, given in zip(paths, options, strict=True):
        given = {k: v for k, v in given.items() if k != "weld"}
        clips = None if "animation" in given else clips_in(path, given)
        if clips is None or len(clips) == 1:
            one = load(path, **given)
            held.add(one.clip or one.name)
            found.append((path, one))
            continue
        known = [clip.name for clip in clips]
        held |= set(known)
        if names is None:
            _warn_of_others(path, known)
            chosen = known[:1]
        else:
            chosen = [name for name in names if name in known] if names else known
        if not chosen:
            raise InputError("--clip", f"a clip of {path}: {', '.join(known)}, or all", names)
        found += [(path, load(path, clip=name, **given)) for name in chosen]
    missing = [name for name in names or () if name not in held]
    if missing:
        raise InputError("--clip", f"one of {', '.join(sorted(held))}, or all", missing[0])
    _check_one_mesh(found)
    shots = _named(found)
    return _welded(shots) if any(given.get("weld") for given in options) else shots


def read_model(
    path: Path, names: list[str] | None, options: dict[str, Any]
) -> MeshSequence | Skinning:
    """A skinning with the named clips (all by default), else a sequence of one clip."""
    thing = read_any(path, **options)
    if isinstance(thing, Skinning):
        known, wanted = [clip.name for clip in thing.clips], wanted_of(names)
        for name in wanted or ():
            if name not in known:
                raise InputError("--clip", f"one of {', '.join(known)}, or all", name)
        return thing.select(*wanted) if wanted else thing
    several = clips_in(path, options) or ()
    if names is None and len(several) < 2:
        return thing
    return one_clip(path, names, options)


def one_clip(path: Path, names: list[str] | None, options: dict[str, Any]) -> MeshSequence:
    """The vertices of one clip."""
    shots = read_clips([path], names, [options])
    if len(shots) > 1:
        known = ", ".join(shot.clip for shot in shots)
        raise InputError("--clip", f"one clip where vertices are read, of {known}", len(shots))
    return shots[0]


def read_pairs(
    paths: tuple[Path, Path], names: list[str] | None, options: Sequence[dict[str, Any]]
) -> list[tuple[str, MeshSequence, MeshSequence]]:
    """The clips of two files side by side; a file of one clip has no choice.

    Raises
    ------
    InputError
        If a clip is missing in one of them, or their numbers differ.
    """
    listed = [clips_in(p, o) or () for p, o in zip(paths, options, strict=True)]
    several = [len(clips) > 1 for clips in listed]
    sides = []
    for path, given, many in zip(paths, options, several, strict=True):
        chosen = (names or ["all"]) if many and "animation" not in given else None
        sides.append(read_clips([path], chosen, [given]))
    if not any(several):
        held = {shot.clip for side in sides for shot in side}
        for name in wanted_of(names) or ():
            if name not in held:
                raise InputError("--clip", f"one of {', '.join(sorted(held))}", name)
    a, b = sides
    if len(a) != len(b) and 1 in (len(a), len(b)):
        whole = join(a), join(b)  # a file without clips may hold the frames of all of them
        if len(whole[0]) == len(whole[1]):
            return [("", *whole)]
    if len(a) != len(b):
        raise InputError(
            "--clip",
            "as many clips of A as of B",
            f"{', '.join(s.clip for s in a)}, and {', '.join(s.clip for s in b)}",
        )
    if len(a) > 1:
        order = {shot.clip: shot for shot in b}
        for shot in a:
            if shot.clip not in order:
                raise InputError("B", f"the clips of A, {shot.clip} too", ", ".join(order))
        b = [order[shot.clip] for shot in a]
    return [(s.clip, s, t) for s, t in zip(a, b, strict=True)]


def check_rates(outputs: Sequence[Path], shots: Sequence[MeshSequence]) -> None:
    """Refuse before the work what a format without room for several rates would refuse after it."""
    rates = {shot.fps for shot in shots}
    for path in outputs:
        format_ = format_of(path)[1]
        vertices = format_.write_skinning is None
        if len(rates) > 1 and (vertices or path.suffix.lower() == ".fbx"):
            raise InputError(
                "--output",
                "a format that holds clips of several frame rates, such as .glb, or one --fps",
                f"{path}, and {', '.join(f'{s.clip} at {s.fps:g}' for s in shots)}",
            )


def clips_document(clips: Sequence[Clip]) -> list[dict[str, Any]]:
    """Clips for JSON."""
    return [
        {**dataclasses.asdict(clip), "frames": clip.n_frames, "duration": clip.n_frames / clip.fps}
        for clip in clips
    ]


def clips_text(clips: Sequence[Clip]) -> str:
    """Clips in one line."""
    return ", ".join(f"{c.name or 'unnamed'} ({c.n_frames} at {c.fps:g} a second)" for c in clips)


def join(shots: Sequence[MeshSequence]) -> MeshSequence:
    """The frames of all clips one behind the other."""
    if len(shots) == 1:
        return shots[0]
    vertices = np.concatenate([np.concatenate([b for _, b in s.chunks()]) for s in shots])
    return dataclasses.replace(shots[0], vertices=vertices, clip="", validate=False)


def _warn_of_others(path: Path, names: list[str]) -> None:
    Output.current.warn(
        f"{path} has {len(names)} clips ({', '.join(names)}): {names[0]} is taken; --clip NAME "
        "takes another, --clip all all of them"
    )


def _check_one_mesh(found: list[tuple[Path, MeshSequence]]) -> None:
    first_path, first = found[0]
    for path, shot in found[1:]:
        if shot.n_vertices != first.n_vertices:
            expected = f"the {first.n_vertices:,} vertices of {first_path}"
            raise InputError(str(path), expected, f"{shot.n_vertices:,}")
        if not np.array_equal(shot.faces, first.faces):
            raise InputError(str(path), f"the triangles of {first_path}", "others")


def _named(found: list[tuple[Path, MeshSequence]]) -> list[MeshSequence]:
    """Each under a name that no other clip has: its own, else with that of its file."""
    own = [shot.clip or shot.name for _, shot in found]
    names = []
    for (path, _), name in zip(found, own, strict=True):
        alone = sum(other == path for other, _ in found) == 1
        twice = own.count(name) > 1
        names.append((path.stem if alone else f"{path.stem}_{name}") if twice else name)
    if len(names) > 1:
        names = list(unique_names(names, "clip"))
    return [
        dataclasses.replace(shot, clip=name, validate=False)
        for (_, shot), name in zip(found, names, strict=True)
    ]


def _welded(shots: list[MeshSequence]) -> list[MeshSequence]:
    """Vertices merged that coincide in every frame of every clip."""
    whole, _ = join(shots).weld()
    ends = np.cumsum([len(shot) for shot in shots])
    return [
        dataclasses.replace(
            whole,
            vertices=whole.vertices[end - len(shot) : end],
            fps=shot.fps,
            name=shot.name,
            clip=shot.clip,
            validate=False,
        )
        for shot, end in zip(shots, ends, strict=True)
    ]
