"""What of an input file passes through a command to its outputs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import FormatError, InputError
from ..io.registry import Format, call, format_of
from .output import Output, write_options

_AXES = "orientations of the joints"


def of_one_format(source: Path, target: Path) -> Format | None:
    """The format of both files, where a file of it can pass through."""
    try:
        format_ = format_of(source)[1]
        return format_ if format_.copy and format_of(target)[1] is format_ else None
    except FormatError:
        return None


def options_with_template(
    target: Path,
    pairs: list[str] | None,
    sources: Sequence[Path],
    read: Sequence[dict[str, Any]],
    *,
    strict: bool,
    new_bones: bool,
    clips: Sequence[str] = (),
) -> dict[str, Any]:
    """Options of :func:`ssdr.save`, the first input of the output's format as its template.

    ``--write template=null`` writes the model alone.

    Parameters
    ----------
    target : Path
    pairs : list of str or None
        ``--write``.
    sources, read
        The inputs, and the options with which each was read.
    strict : bool
    new_bones : bool
        Whether the model's bones are not the input's, whose joints then count for nothing.
    clips : names
        Clips of the model, which may be called after the files that they come from.

    Raises
    ------
    InputError
        If `strict`, and something cannot be kept.
    """
    options = write_options(pairs, target)
    asked = "template" in options
    if asked and options["template"] is None:
        del options["template"]
    lost: list[str] = []
    for source, given in zip(sources, read, strict=True):
        format_ = of_one_format(source, target)
        if format_ is None or asked or not source.is_file():
            continue
        assert format_.template_problem is not None
        problem = call(format_, format_.template_problem, source)
        if problem:
            Output.current.warn(f"{target} is written anew: {source}: {problem}")
            continue
        # What the caller turns, it turns away from the file.
        if options.get("up", "y" if format_.module == "gltf" else None) in (given.get("up"), "y"):
            options["template"] = source
            options |= {k: v for k, v in given.items() if k == "meshes"}
            names = _renamed(source, clips)
            if names:
                options["clip_names"] = names
            if strict:
                options["strict"] = True
            if not new_bones and _AXES in _lost(source, given):
                lost.append(_AXES)
        break
    if "template" not in options:
        for source, given in zip(sources, read, strict=True):
            lost += [x for x in _lost(source, given) if x not in lost]
        if new_bones and _AXES in lost:
            lost.remove(_AXES)
    if lost:
        said = f"not kept in {target}: {', '.join(lost)}"
        if strict:
            raise InputError("--strict", "an output that keeps all of the input", said)
        Output.current.warn(said)
    return options


def _renamed(source: Path, clips: Sequence[str]) -> dict[str, str]:
    """Clips of the file that have another name in the model."""
    from ..io import list_clips

    names = {}
    for clip in list_clips(source):
        now = [n for n in (clip.name, source.stem, f"{source.stem}_{clip.name}") if n in clips]
        if now and now[0] != clip.name:
            names[clip.name] = now[0]
    return names


def _lost(source: Path, given: dict[str, Any]) -> tuple[str, ...]:
    from ..io import left_out

    return left_out(source, **given) if source.is_file() else ()
