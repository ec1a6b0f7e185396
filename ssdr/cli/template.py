"""Choice of an input as template, from which an output keeps all but the mesh's skin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..io.formats import FORMATS, format_of
from .format_options import PLACED, readable_format, write_options
from .output import Output

Inputs = Mapping[Path, dict[str, Any]]


def options_with_template(
    target: Path, pairs: list[str] | None, inputs: Inputs, *, clips: Sequence[str] = ()
) -> dict[str, Any]:
    """Options of :func:`ssdr.save` for an output, with an input as template if one is suitable.

    The template is the first input of the output's format that can be one. The option
    ``template=null`` writes the model without a template.

    Parameters
    ----------
    target : Path
    pairs : list of str or None
        Values of ``--write``.
    inputs : mapping of Path to dict
        The inputs, and the options with which each of them was read.
    clips : names
        Names of the model's clips; a clip may be named after its file.
    """
    options = write_options(pairs, target)
    if "template" in options:
        return options
    source = _template(target, options, inputs)
    if source is not None:
        names = _new_names(source, clips)
        options |= {"template": source}
        options |= {k: v for k, v in inputs[source].items() if k == "meshes"}
        options |= {"clip_names": names} if names else {}
    return options


def _template(target: Path, options: dict[str, Any], inputs: Inputs) -> Path | None:
    """First input that can be the template of an output, or None if there is none."""
    for source, read in inputs.items():
        format_ = readable_format(source)
        if format_ is not FORMATS[".glb"] or format_ is not format_of(target):
            continue
        from ..io.gltf.template import template_problem

        problem = template_problem(source)
        if not problem:
            # A model that was scaled or is said to be elsewhere does not fit the rest of the file.
            return None if PLACED & (read.keys() | options.keys()) else source
        Output.current.warn(f"{target} is written anew: {source}: {problem}")
    return None


def _new_names(source: Path, clips: Sequence[str]) -> dict[str, str | None]:
    """Dict from the name of a clip in the file to its name in the model, where these differ.

    None stands for a clip that was left out by `--clip` or with a warning.
    """
    from ..io import list_clips

    names: dict[str, str | None] = {}
    for clip in list_clips(source):
        candidates = (clip.name, source.stem, f"{source.stem}_{clip.name}")
        names[clip.name] = next((name for name in candidates if name in clips), None)
    return {old: new for old, new in names.items() if old != new}
