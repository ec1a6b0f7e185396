"""Choice of an input as template, from which an output keeps all but the mesh's skin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..io.registry import Format, call, format_of
from .format_options import PLACED, STRICT, readable_format, write_options
from .output import Output

Inputs = Mapping[Path, dict[str, Any]]
_AXES = "orientations of the joints"


def shared_format(source: Path, target: Path) -> Format | None:
    """Format of both files if files of it can be copied with all contents, otherwise None."""
    format_ = readable_format(source)
    if format_ is None or not format_.has("copy") or format_of(target)[1] is not format_:
        return None
    return format_ if source.is_file() else None


def options_with_template(
    target: Path,
    pairs: list[str] | None,
    inputs: Inputs,
    *,
    new_bones: bool,
    clips: Sequence[str] = (),
) -> dict[str, Any]:
    """Options of :func:`ssdr.save` for an output, with an input as template if one is suitable.

    The template is the first input of the output's format that can be one. A warning names the
    contents of the inputs that are not kept; with the option ``strict=true`` there is an error
    instead. The option ``template=null`` writes the model without a template.

    Parameters
    ----------
    target : Path
    pairs : list of str or None
        Values of ``--write``.
    inputs : mapping of Path to dict
        The inputs, and the options with which each of them was read.
    new_bones : bool
        Whether the output has other bones than the inputs. If so, there is no warning that
        orientations of the input's joints are not kept.
    clips : names
        Names of the model's clips; a clip may be named after its file.

    Raises
    ------
    InputError
        If something cannot be kept, with ``strict=true``.
    """
    options = write_options(pairs, target)
    strict, asked = bool(options.pop(STRICT, False)), "template" in options
    source = options.pop("template") if asked else _template(target, options, inputs)
    lost = [] if asked and source is not None else _left_out(inputs)
    if source is not None:
        options |= {"template": source} | ({STRICT: True} if strict else {})
        lost = [what for what in lost if what == _AXES]
        if not asked:
            names = _new_names(source, clips, strict and not Output.current.options.clip)
            options |= {k: v for k, v in inputs[source].items() if k == "meshes"}
            options |= {"clip_names": names} if names else {}
    if new_bones:
        lost = [what for what in lost if what != _AXES]
    if lost:
        said = f"not kept in {target}: {', '.join(lost)}"
        if strict:
            raise InputError("strict", "an output that keeps all of the input", said)
        Output.current.warn(said)
    return options


def _template(target: Path, options: dict[str, Any], inputs: Inputs) -> Path | None:
    """First input that can be the template of an output, or None if there is none."""
    for source, read in inputs.items():
        format_ = shared_format(source, target)
        if format_ is None:
            continue
        problem = call(format_, "template_problem", source)
        if not problem:
            # A model that was scaled or is said to be elsewhere does not fit the rest of the file.
            return None if PLACED & (read.keys() | options.keys()) else source
        Output.current.warn(f"{target} is written anew: {source}: {problem}")
    return None


def _new_names(source: Path, clips: Sequence[str], every: bool) -> dict[str, str | None]:
    """Dict from the name of a clip in the file to its name in the model, where these differ.

    None stands for a clip that was left out by `--clip` or with a warning.
    """
    from ..io import list_clips

    names: dict[str, str | None] = {}
    for clip in list_clips(source):
        candidates = (clip.name, source.stem, f"{source.stem}_{clip.name}")
        left = clip.name if every else None
        names[clip.name] = next((name for name in candidates if name in clips), left)
    return {old: new for old, new in names.items() if old != new}


def _left_out(inputs: Inputs) -> list[str]:
    """Phrases that name the contents of the input files that a model cannot hold."""
    from ..io import left_out

    files = [(path, read) for path, read in inputs.items() if path.is_file()]
    return list(dict.fromkeys(what for path, read in files for what in left_out(path, **read)))
