"""The preset of an engine (``--for``) and the root joint (``--root-motion``)."""

from __future__ import annotations

import dataclasses
from typing import Any

from ..engines import ENGINES, Engine, findings, n_roots
from ..hierarchy.root_motion import with_root
from ..skinning import Skinning
from .format_options import write_weights
from .options import FitOptions
from .output import Output


def preset(options: FitOptions, engine: Engine) -> str:
    """Set options that the user left open to what suits an engine; return a text about them."""
    influences, storage = options.influences or (engine.influences, None)
    options.outputs = [
        path if path.suffix else path.with_suffix(engine.suffixes[0]) for path in options.outputs
    ]
    suffixes = dict.fromkeys(path.suffix.lower() for path in options.outputs)
    said = [f"{engine.title}: {influences} influences", ", ".join(suffixes)]
    own = any("weights=" in pair for pair in options.write or ())
    if storage is None:  # what the engine holds by default; finer integers hold it as well
        storage = engine.write if engine.storage == "float32" else engine.storage
        if write_weights(options, engine.write) and not own:
            said += [f"weights as {engine.write}"]
    if storage != "float32" and not isinstance(options.bones, tuple):
        said.append(f"solved for {storage}")
    options.influences = influences, storage
    return ", ".join([*said, f"once imported {engine.space}"])


def finished(
    result: Any, options: FitOptions, engine: Engine | None, root_motion: bool, said: dict[str, str]
) -> Any:
    """Copy of `result` with a root joint in its model, if it is requested or the engine needs it.

    Warnings say what the engine would refuse, cut off or rename.  Rows of the table about the root
    and about weights that the engine would round are added to `said`.
    """
    model: Skinning = result.skinning
    if root_motion or (engine is not None and engine.one_root and n_roots(model) > 1):
        model = with_root(model, moving=root_motion)
        does = "carries the ground track and heading" if root_motion else "stands still"
        axis = model.space.up or "y (not stated)"
        said["root"] = f"{model.names()[-1]}, above all bones, {does}; up axis {axis}"
        result = dataclasses.replace(result, skinning=model)
    if engine is not None:
        suffixes = dict.fromkeys(path.suffix.lower() for path in options.outputs)
        for finding in dict.fromkeys(f for s in suffixes for f in findings(model, engine, s)):
            if finding.kind == "rounded":
                said["rounded"] = finding.text
            else:
                Output.current.warn(f"{engine.title}: {finding.kind}: {finding.text}")
    return result


def engine_of(name: str | None) -> Engine | None:
    """Engine that ``--for`` names, or None if that is not given."""
    return None if name is None else ENGINES[name]  # type: ignore[index]
