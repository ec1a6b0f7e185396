"""What ``ssdr decompose`` and ``ssdr smallest`` say about their result."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from ..clips import names_of
from ..io.registry import SaveReport
from ..sequence import MeshSequence
from .options import FitOptions
from .output import in_words, saved_line
from .reading import clips_document, clips_text

_ROWS = {
    "input": "{input}: {frames:,} frames, {vertices:,} vertices, {triangles:,} triangles, "
    "diagonal {diagonal:.4g}",
    "model": "{bones} bones, {influences} influences",
    "RMSE": "{rmse:.4g} in the mesh's units, {rmse_percent:.3g} % of the diagonal",
    "E": "{E:.4g} = 1000 RMSE / sqrt(3)",
    "time": "{total_seconds:.1f} s: loading {load_seconds:.1f}, compiling {compile_seconds:.1f}, "
    "solving {seconds:.1f}, saving {save_seconds:.1f}",
}
_PARSIMONY = {
    "tolerance": "{measure} {error:.4g} of {tolerance:.4g}, held: {held}",
    "size": "{bytes:,} bytes in an engine: rest pose {size[rest]:,}, weights {size[weights]:,}, "
    "joints {size[joints]:,}, keys {size[keys]:,}; files hold more, such as triangles",
}
_PRUNING = (
    "{before:,} to {after:,}, bytes {bytes_before:,} to {bytes_after:,}, "
    "error {error_before:.4g} to {error_after:.4g}"
)
_ENDINGS = {
    "converged": "the search converged",
    "effort spent": "every step of this effort is done",
    "time limit": "the time limit was reached: the best model so far",
    "cancelled": "interrupted: the best model so far",
    "tolerance held": "no smaller model was found within the tolerance",
    "tolerance out of reach": "no model was found within the tolerance: the closest",
}


def summary(
    command: str,
    options: FitOptions,
    shots: Sequence[MeshSequence],
    result: Any,
    reports: Sequence[SaveReport],
    more: dict[str, Any],
) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """The result for JSON, and as a table of names and values; `more` is part of both."""
    from .. import __version__

    diagonal, clips = max(shot.diagonal() for shot in shots), names_of(shots)["clips"]
    document = {
        "command": command,
        "version": __version__,
        "input": options.inputs[0] if len(options.inputs) == 1 else options.inputs,
        "frames": sum(map(len, shots)),
        "vertices": shots[0].n_vertices,
        "triangles": len(shots[0].faces),
        "clips": clips_document(clips),
        "bones": result.skinning.n_bones,
        "influences": result.skinning.n_influences,
        "effort": options.effort,
        "seed": options.seed,
        "rmse": result.rmse,
        "rmse_percent": 100 * result.rmse / diagonal if diagonal > 0 else math.nan,
        "E": 1000 * result.rmse / math.sqrt(3),
        "diagonal": diagonal,
        "converged": result.converged,
        "stop_reason": result.stop_reason,
        "iterations": result.history[-1].iteration if result.history else 0,
        "outputs": [dataclasses.asdict(report) for report in reports],
        "checkpoint": options.checkpoint,
        **more,
    }
    rows = in_words(document | {"input": options.inputs}, _ROWS)
    if len(clips) > 1:
        rows.insert(1, ("clips", clips_text(clips)))
    parsimony = getattr(result, "parsimony", None)
    if parsimony is not None:
        found = dataclasses.asdict(parsimony) | {"bytes": parsimony.size.total}
        document["parsimony"] = found
        rows += in_words(found, _PARSIMONY)
        rows += [(p["what"], _PRUNING.format_map(p)) for p in found["prunings"]]
    rows.append(("ended", _ENDINGS.get(result.stop_reason, result.stop_reason)))
    rows += [("wrote", saved_line(report, diagonal)) for report in reports]
    return document, rows
