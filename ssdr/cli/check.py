"""The command ``ssdr check``."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from ..engines import ENGINES, EngineName, findings
from ..errors import FormatError
from ..sequence import MeshSequence
from ..skinning import Skinning
from .format_options import read_options
from .options import FILES, Options, argument, option, takes
from .output import Output
from .reading import read_model


@dataclasses.dataclass(kw_only=True)
class CheckOptions(Options):
    """Arguments and options of ``ssdr check``."""

    source: Annotated[Path, argument("FILE", "A skinned model.")]
    engine: Annotated[EngineName, option(FILES, "Engine that is to read the file.", "--for")]


@takes
def check(options: CheckOptions) -> None:
    """Say what an engine would refuse, cut off, round or rename of a model file.

    The exit code is 1 where something would be refused.
    """
    from ..metrics.normal_angles import known_errors

    output = Output.start(options)
    source, engine = options.source, ENGINES[options.engine]
    (read,) = read_options([source], options)
    with output.waiting(f"loading {source}"):
        model = read_model(source, options.clip, read)
    if not isinstance(model, Skinning):
        raise FormatError(f"{source}: holds no skin weights, so nothing that an engine limits")
    found = findings(model, engine, source.suffix.lower())
    refused = any(finding.kind == "refused" for finding in found)
    rows = [("file", f"{source}, for {engine.title}")]
    rows += [(finding.kind, finding.text) for finding in found]
    rows += [] if found else [("nothing", "is refused, cut off, rounded or renamed")]
    normals = None
    if len(model.faces):
        own = MeshSequence(model.skin(), model.faces, surface=model.surface, validate=False)
        normals = known_errors(own, model)
    if normals is not None:
        rows.append(("normals", f"{normals}, as drawn, from those of its own surface"))
    rows.append(("space", f"{model.space}; once imported {engine.space}"))
    document = {
        "command": "check",
        "input": source,
        "for": options.engine,
        "refused": refused,
        "normals": None if normals is None else normals.as_dict(),
        "findings": [dataclasses.asdict(finding) for finding in found],
        **dataclasses.asdict(model.space),
    }
    output.result(document, rows)
    if refused:
        raise typer.Exit(1)
