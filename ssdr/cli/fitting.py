"""Steps that ``ssdr decompose`` and ``ssdr smallest`` share: read, solve, save and print."""

from __future__ import annotations

import dataclasses
import math
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..clips import names_of
from ..errors import Cancelled, InputError
from ..io.save_report import SaveReport
from ..sequence import MeshSequence, joined
from ..signals import stop_on_signals
from ..space import Space
from .format_options import read_options
from .options import PAGES, FitOptions
from .output import Output, in_words, saved_line
from .reading import clips_document, clips_text, meshes_text, read_any, read_clips
from .saving import check_file, check_outputs, save_model, try_format
from .template import options_with_template

Solver = Callable[..., Any]
Shots = list[MeshSequence]
_SHARED = (
    "bones",
    "influences",
    "effort",
    "bone_model",
    "rest_pose",
    "normals",
    "time_limit",
    "checkpoint",
)
_ROWS = {
    "input": "{input}: {frames:,} frames, {vertices:,} vertices, {triangles:,} triangles, "
    "diagonal {diagonal:.4g}",
    "model": "{bones} bones, {influences} influences",
    "RMSE": "{rmse:.4g} in the mesh's units, {rmse_percent:.3g} % of the diagonal{of_motion}",
    "largest": "{max_error:.4g}, {max_error_percent:.3g} % of the diagonal, of any vertex",
    "E": "{E:.4g} = 1000 RMSE / sqrt(3)",
    "time": "{total_seconds:.1f} s: loading {load_seconds:.1f}, compiling {compile_seconds:.1f}, "
    "solving {seconds:.1f}, saving {save_seconds:.1f}",
}
_PARSIMONY = {
    "tolerance": "{measure} {error:.4g} of {tolerance:.4g}, held: {held}",
    "size": "{bytes:,} bytes in an engine: rest pose {size[rest]:,}, weights {size[weights]:,}, "
    "joints {size[joints]:,}, keys {size[keys]:,}; files hold more, such as triangles",
}
_PRUNING = "{before:,} to {after:,}: {bytes_after:,} bytes, error {error_after:.4g}"
_ENDINGS = {
    "converged": "the search converged",
    "effort spent": "every step of this effort is done",
    "time limit": "the time limit was reached: the best model so far",
    "cancelled": "interrupted: the best model so far",
    "tolerance held": "no smaller model was found within the tolerance",
    "tolerance out of reach": "no model was found within the tolerance: the closest",
}


def fit(
    command: str,
    solve: Solver,
    options: FitOptions,
    arguments: Callable[[], dict[str, Any]],
) -> None:
    """Read the inputs, call the solver, save its model and print the result.

    Parameters
    ----------
    command : str
        Name of the command.
    solve : callable
        :func:`ssdr.decompose` or :func:`ssdr.smallest`.
    options : FitOptions
    arguments : callable
        Function that checks the options that only this command has, and returns their arguments for
        `solve`.

    Raises
    ------
    Cancelled
        If a signal stopped the solver; the best model, if there was one, has then been saved.
    """
    from ..solver.warmup import begin_compiling

    output = Output.start(options)
    began = time.perf_counter()
    _check_files(options)
    begin_compiling()  # while the files are read
    own = arguments()
    shots, start, settings = _read(options, output)
    _place(own, shots[0].space)
    own.setdefault("start", start)
    loaded = time.perf_counter()
    with stop_on_signals() as stop:
        result = _solve(solve, options, shots, stop, own)
        solved = time.perf_counter()
        reports = save_model(result.skinning, settings)
        drawn = [] if stop.is_set() else options.drawn
        reports += [_draw(path, options, shots, result) for path in drawn]
    saved = time.perf_counter()
    about = {
        "command": command,
        "load_seconds": loaded - began,
        "compile_seconds": result.compile_seconds,
        "seconds": solved - loaded - result.compile_seconds,
        "save_seconds": saved - solved,
        "total_seconds": saved - began,
    }
    _print(options, shots, result, reports, about)
    if stop.is_set():
        raise Cancelled("interrupted; the best model so far is saved (--start goes on from it)")


def _check_files(options: FitOptions) -> None:
    """Raise an InputError at once if an output could not be written after solving."""
    check_outputs(options.outputs, options.write, sources=options.inputs)
    others = [*options.inputs, *options.outputs]
    for path in options.drawn:
        check_file(path, "--output", others=others)
        others.append(path)
    checkpoint = options.checkpoint
    if checkpoint is not None:
        if checkpoint.suffix.lower() != ".npz":
            raise InputError("--checkpoint", "a file ending in .npz", str(checkpoint))
        check_file(checkpoint, "--checkpoint", others=others)


def _read(options: FitOptions, output: Output) -> tuple[Shots, Any, dict[Path, dict[str, Any]]]:
    """Read the inputs; return their clips, the solver's start, and options to save each output."""
    names = ", ".join(map(str, options.inputs))
    read = read_options(options.inputs, options)
    with output.waiting(f"loading {names}"):
        shots = read_clips(options.inputs, options.clip, read)
        start = _start(options.start, shots[0].space)
    if sum(map(len, shots)) == 1:
        numbered = re.sub(r"\d+(?=\D*$)", "*", options.inputs[0].name)
        hint = f": did you mean {numbered}?" if numbered != options.inputs[0].name else ""
        raise InputError("IN", "an animation", f"one frame, {names} (no motion{hint})")
    clips = names_of(shots)["clips"]
    inputs, settings = dict(zip(options.inputs, read, strict=True)), {}
    for path in options.outputs:
        settings[path] = options_with_template(
            path, options.write, inputs, clips=[clip.name for clip in clips]
        )
        try_format(path, settings[path], options, shots[0], clips)
    return shots, start, settings


def _start(text: str | None, space: Space) -> Any:
    """Read `--start`, a model to start from or a mesh as rest pose, in the inputs' `space`."""
    import ssdr

    if text is None:
        return None
    return ssdr.io.in_space(read_any(Path(text)), space)


def _place(own: dict[str, Any], space: Space) -> None:
    """Convert the skeleton in `own`, and the rest pose that `own` takes from it, to `space`."""
    import ssdr

    rig = own.get("rig")
    if isinstance(rig, ssdr.Skeleton):
        model = ssdr.io.in_space(rig.skinning, space)
        own["rig"] = dataclasses.replace(rig, skinning=model)
        if "start" in own:
            own["start"] = dataclasses.replace(own["start"], rest=model.rest)


def _solve(
    solve: Solver, options: FitOptions, shots: Shots, stop: threading.Event, own: dict[str, Any]
) -> Any:
    """Run the solver until it ends or `stop` is set, show its progress, and return its result.

    `own` holds the arguments that only this command has.
    """
    own |= {name: getattr(options, name) for name in _SHARED} | {"rng": options.seed}
    with Output.current.progress_bar() as show:

        def follow(progress: Any) -> bool:
            rmse = f"RMSE {progress.rmse:.4g}" if math.isfinite(progress.rmse) else ""
            show(progress.phase, progress.fraction, rmse)
            return stop.is_set()

        return solve(shots[0] if len(shots) == 1 else shots, callback=follow, **own)


def _draw(path: Path, options: FitOptions, shots: Shots, result: Any) -> SaveReport:
    """Write a page that shows the result beside the input, or a contact sheet."""
    import ssdr

    from ..render.figures import contact_sheet, write_picture

    title = options.inputs[0].stem
    with Output.current.waiting(f"drawing {path}"):
        if path.suffix.lower() not in PAGES:
            sheet = contact_sheet(result.skinning, reference=joined(shots), title=title)
            write_picture(sheet, path)
            return SaveReport(path=path, bytes=path.stat().st_size)
        files = [file for file in options.outputs if file.is_file()]
        page = ssdr.view(
            result,
            shots,
            path,
            title=title,
            file=files[0] if files else None,
            reference_name=", ".join(source.name for source in options.inputs),
        )
        return SaveReport(path=page.path, bytes=page.bytes, notes=tuple(page.notes))


def _print(
    options: FitOptions,
    shots: Shots,
    result: Any,
    reports: list[SaveReport],
    about: dict[str, Any],
) -> None:
    """Print the result: as a table or as JSON with the entries `about`."""
    from .. import __version__
    from ..frames.error import largest_error, motion_rms, share_of
    from ..metrics.vertex_distances import distances

    diagonal, clips = max(shot.diagonal() for shot in shots), names_of(shots)["clips"]
    model = result.skinning
    motion = motion_rms(shots)
    arrays = (model.rest, model.indices, model.weights, model.transforms)
    if model.shapes is None:
        largest = largest_error(shots, *arrays)
    else:
        largest = distances(joined(shots), model).max
    document = {
        **about,
        "version": __version__,
        "input": options.inputs[0] if len(options.inputs) == 1 else options.inputs,
        "frames": sum(map(len, shots)),
        "vertices": shots[0].n_vertices,
        "copies": result.copies,
        "triangles": len(shots[0].faces),
        "clips": clips_document(clips),
        "bones": model.n_bones,
        "influences": model.n_influences,
        "effort": options.effort,
        "seed": options.seed,
        "rmse": result.rmse,
        "rmse_percent": 100 * result.rmse / diagonal if diagonal > 0 else math.nan,
        "motion": motion,
        "percent_of_motion": 100 * share_of(result.rmse, motion),
        "max_error": largest,
        "max_error_percent": 100 * largest / diagonal if diagonal > 0 else math.nan,
        "E": 1000 * result.rmse / math.sqrt(3),
        "diagonal": diagonal,
        "converged": result.converged,
        "stop_reason": result.stop_reason,
        "iterations": result.history[-1].iteration if result.history else 0,
        "outputs": [dataclasses.asdict(report) for report in reports],
        "checkpoint": options.checkpoint,
    }
    of_motion = f", {document['percent_of_motion']:.3g} % of the motion" if motion > 0 else ""
    rows = in_words(document | {"input": options.inputs, "of_motion": of_motion}, _ROWS)
    if result.normals is not None:
        document["normals"] = result.normals.as_dict()
        rows.insert(-1, ("normals", f"{result.normals}, as engines draw them"))
    if len(clips) > 1:
        rows.insert(1, ("clips", clips_text(clips)))
    if not any("meshes" in pair for pair in options.read or ()):
        rows.insert(1, ("meshes", meshes_text(options.inputs[0])))
    if result.copies:
        rows.insert(
            1, ("copies", f"{result.copies:,} vertices lie on others in every frame: solved as one")
        )
    parsimony = getattr(result, "parsimony", None)
    if parsimony is not None:
        found = dataclasses.asdict(parsimony) | {"bytes": parsimony.size.total}
        document["parsimony"] = found
        shown = {k: text for k, text in _PARSIMONY.items() if found.get(k, True)}
        rows += [(name.replace("_", " "), text) for name, text in in_words(found, shown)]
        rows += [(p["what"], _PRUNING.format_map(p)) for p in found["prunings"]]
    rows.append(("ended", _ENDINGS.get(result.stop_reason, result.stop_reason)))
    rows += [("wrote", saved_line(report, diagonal)) for report in reports]
    Output.current.result(document, rows)
