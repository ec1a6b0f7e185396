"""The commands that solve: decompose and smallest."""

from __future__ import annotations

import dataclasses
import math
import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import ssdr

from ..common.checks import parse_normals, parse_tolerance
from ..common.errors import Cancelled, InputError
from ..common.signals import stop_on_signals
from ..decomposition import decompose as _decompose
from ..io import SaveReport, check_outputs, in_space, list_left_out, load_any, load_clips, save_all
from ..io.outputs import check_file
from ..mesh.clips import names_of
from ..mesh.sequence import MeshSequence, joined
from ..model.start import JointKind
from ..parsimony.smallest import smallest as _smallest
from .files import PAGES, READ, WRITTEN, files_of, load_rig
from .output import Output, clips_document, clips_text, in_words, saved_line
from .parameters import passes

_DRAWN = (*PAGES, ".png", ".jpg", ".jpeg", ".webp", ".gif", ".tif", ".tiff", ".bmp", ".pdf")
_ROWS = {
    "input": "{input}: {frames:,} frames, {vertices:,} vertices, {triangles:,} triangles, "
    "diagonal {diagonal:.4g}",
    "model": "{bones} bones, {influences} influences",
    "RMSE": "{of_motion}{length}, {rmse_percent:.3g} % of the diagonal",
    "largest": "{largest}, {max_error_percent:.3g} % of the diagonal, of any vertex",
    "time": "{total_seconds:.1f} s: compiling {compile_seconds:.1f}, solving {seconds:.1f}",
}
_PARSIMONY = {
    "tolerance": "{measure} {error:.4g} of {tolerance:.4g}, held: {held}",
    "size": "{bytes:,} bytes in an engine: rest pose {size[rest]:,}, weights {size[weights]:,}, "
    "joints {size[joints]:,}, keys {size[keys]:,}; files hold more, such as triangles",
}
_PRUNING = "{before:,} to {after:,}: {bytes_after:,} bytes, error {error_after:.4g}"


@passes(
    *(_decompose, *READ, *WRITTEN),
    without=["joints_alone"],
)
def decompose(
    inputs: list[Path],
    *,
    output: list[Path],
    rig: str | None = None,
    joints: JointKind | None = None,
    extra_bones: int = 0,
    keep_weights: bool = False,
    start: Path | None = None,
    **options: Any,
) -> None:
    """Fit a rest pose, sparse skin weights and bones to an animated mesh.

    Several files of one mesh, or several clips of a file (--clip all), get one rest pose and one
    set of weights; each clip becomes an animation of its own.

    From glTF to glTF, the file gets a new skin and keeps the rest of what it holds.

    Ctrl-C stops and saves the best model so far; a second Ctrl-C ends at once.

    Parameters
    ----------
    inputs : list of Path
        Animated mesh; several files of one mesh are its clips.
    output : list of Path
        Model to write; repeat it for other formats, a contact sheet (.png) or a page (.html).
    rig : str, optional
        Connect the bones by joints that may come apart (loose) or not (rigid), or keep the joints,
        parents and names of a file.
    joints : {"rigid", "loose", "kept"}, optional
        Whether the joints of --rig FILE may come apart, or move as in that file, which is the
        default where it holds joints that move and no mesh.
    extra_bones : int
        Bones to add to those of --rig FILE.
    keep_weights : bool
        Keep the weights and the rest pose of --rig FILE.
    start : Path, optional
        Go on from a model or checkpoint; of a mesh, the first frame is the rest pose, which is
        kept.
    """
    if rig in (None, "loose", "rigid"):
        for name, value in (
            ("joints", joints),
            ("extra-bones", extra_bones),
            ("keep-weights", keep_weights),
        ):
            if value:
                raise InputError(f"--{name}", "the file of a rig beside it (--rig FILE)", rig)
        if options.get("bones") is None and start is None:
            found = f"ssdr smallest {inputs[0]} -o {output[0]} --tolerance 0.5%"
            wanted = f"a number of bones ({found} finds it), --rig FILE or --start MODEL"
            raise InputError("--bones", wanted, "none")
        _fit(ssdr.decompose, inputs, output, start, options, lambda shots: {"rig": rig})
        return
    if keep_weights and start is not None:
        raise InputError("--start", "none beside --keep-weights", start)

    def kept(shots: list[MeshSequence]) -> dict[str, Any]:
        there, how = in_space(load_rig(Path(rig), shots), shots[0].space), joints
        if how is None:
            bare = there.n_vertices == there.n_bones and there.n_frames > 1
            how = "kept" if bare and not len(there.faces) else "rigid"
        skeleton = ssdr.Skeleton(there, joints=how, extra_bones=extra_bones)
        same = {name: getattr(there, name) for name in ("rest", "indices", "weights")}
        return {"rig": skeleton} | ({"start": ssdr.Kept(**same)} if keep_weights else {})

    _fit(ssdr.decompose, inputs, output, start, options, kept)


@passes(
    *(_smallest, *READ, *WRITTEN),
    without=["joints_alone"],
    words=[_decompose],
)
def smallest(
    inputs: list[Path],
    *,
    output: list[Path],
    rig: JointKind | None = None,
    start: Path | None = None,
    **options: Any,
) -> None:
    """Find the model with the fewest bones within an error tolerance.

    Parameters
    ----------
    inputs : list of Path
        Animated mesh; several files of one mesh are its clips.
    output : list of Path
        Model to write; repeat it for other formats, a contact sheet (.png) or a page (.html).
    rig : {"loose", "rigid"}, optional
        Connect the bones by joints that may come apart (loose) or not (rigid).
    start : Path, optional
        A model to begin from, such as a checkpoint.
    """
    parse_tolerance(options["tolerance"], 1.0)
    _fit(ssdr.smallest, inputs, output, start, options, lambda shots: {"rig": rig})


def _fit(
    solve: Callable[..., Any],
    inputs: list[Path],
    output: list[Path],
    start: Path | None,
    options: dict[str, Any],
    arguments: Callable[[list[MeshSequence]], dict[str, Any]],
) -> None:
    """Read the inputs, solve, save and print the result.

    `arguments` gives the arguments of `solve` that only one command has, from the inputs.

    Raises
    ------
    Cancelled
        If a signal stopped the solver; the best model has then been saved.
    """
    from ..solver.warmup import begin_compiling

    began = time.perf_counter()
    parse_normals(options.get("normals", True))
    drawn = [path for path in output if path.suffix.lower() in _DRAWN]
    models = [path for path in output if path not in drawn]
    checkpoint = options.get("checkpoint")
    if not models:
        raise InputError("--output", "a file for the model, too", str(drawn[0]))
    if checkpoint is not None and checkpoint.suffix.lower() != ".npz":
        raise InputError("--checkpoint", "a file ending in .npz", str(checkpoint))
    reading, writing = files_of(options, inputs)
    check_outputs(models, inputs=inputs, **writing)
    for k, path in enumerate(drawn):
        check_file(path, "output", others=[*inputs, *models, *drawn[:k]])
    if checkpoint is not None:
        check_file(checkpoint, "checkpoint", others=[*inputs, *output])
    begin_compiling()  # while the files are read
    model: Any
    with Output.current.waiting(f"loading {', '.join(map(str, inputs))}"):
        shots = load_clips(inputs, **reading)
        not_read = [name for path in inputs for name in list_left_out(path)]
        options |= arguments(shots)
        if start is not None:
            model = in_space(load_any(start), shots[0].space)
            bare = isinstance(model, MeshSequence)
            options["start"] = ssdr.Kept(rest=model.frames(0)) if bare else model
    _check_motion(shots, inputs[0])
    loaded = time.perf_counter()
    with stop_on_signals() as stop:
        with Output.current.progress_bar() as show:

            def follow(progress: Any) -> bool:
                rmse = f"RMSE {progress.rmse:.4g}" if math.isfinite(progress.rmse) else ""
                show(progress.phase, progress.fraction, rmse)
                return stop.is_set()

            result = solve(shots[0] if len(shots) == 1 else shots, callback=follow, **options)
        solved = time.perf_counter()
        with Output.current.waiting(f"saving {', '.join(map(str, models))}"):
            reports: list[Any] = save_all(result, models, **writing)
        for path in [] if stop.is_set() else drawn:
            with Output.current.waiting(f"drawing {path}"):
                reports.append(_draw(path, result, shots, inputs, models[0]))
    document = {
        "compile_seconds": result.compile_seconds,
        "seconds": solved - loaded - result.compile_seconds,
        "total_seconds": time.perf_counter() - began,
        "input": inputs[0] if len(inputs) == 1 else inputs,
        "outputs": reports,
        "not_read": list(dict.fromkeys(not_read)),
        **_measured(result, shots),
    }
    Output.current.result(document, _rows(document, result, shots))
    if stop.is_set():
        raise Cancelled("interrupted; the best model so far is saved (--start goes on from it)")


def _check_motion(shots: Sequence[MeshSequence], path: Path) -> None:
    if sum(map(len, shots)) == 1:
        numbered = re.sub(r"\d+(?=\D*$)", "*", path.name)
        hint = f": did you mean {numbered}?" if numbered != path.name else ""
        raise InputError("inputs", "an animation", f"one frame, {path} (no motion{hint})")


def _measured(result: Any, shots: Sequence[MeshSequence]) -> dict[str, Any]:
    """Entries of the JSON object about a result."""
    from ..model.frame_error import largest_error

    model, diagonal = result.skinning, max(shot.diagonal() for shot in shots)
    arrays = (model.rest, model.indices, model.weights, model.transforms)
    largest = largest_error(shots, *arrays)
    percent = 100 / diagonal if diagonal > 0 else math.nan
    found = {
        "version": ssdr.__version__,
        "frames": sum(map(len, shots)),
        "vertices": shots[0].n_vertices,
        "copies": result.copies,
        "triangles": len(shots[0].faces),
        "clips": clips_document(names_of(shots)["clips"]),
        "bones": model.n_bones,
        "influences": model.n_influences,
        "rmse": result.rmse,
        "rmse_percent": percent * result.rmse,
        "motion": result.motion,
        "percent_of_motion": 100 * result.motion_lost,
        "max_error": largest,
        "max_error_percent": percent * largest,
        "diagonal": diagonal,
        "stop_reason": result.stop_reason,
    }
    if result.normals is not None:
        found["normals"] = result.normals.as_dict()
    if hasattr(result, "parsimony"):
        parsimony = result.parsimony
        found["parsimony"] = dataclasses.asdict(parsimony) | {"bytes": parsimony.size.total}
    return found


def _rows(
    document: dict[str, Any], result: Any, shots: Sequence[MeshSequence]
) -> list[tuple[str, str]]:
    """Rows of the table about a result."""
    motion, units = f"{document['percent_of_motion']:.3g} % of the motion, ", shots[0].space.units
    given = document["input"] if isinstance(document["input"], list) else [document["input"]]
    said = {"input": given, "of_motion": motion if document["motion"] > 0 else ""}
    for name, length in (("length", result.rmse), ("largest", document["max_error"])):
        metres = f"{1000 * length * units:.4g} mm" if units else f"{length:.4g} in the mesh's units"
        said[name] = metres
    clips, rows = names_of(shots)["clips"], in_words(document | said, _ROWS)
    rows[1:1] = [
        ("not read", ", ".join(document["not_read"])),
        ("clips", clips_text(clips) if len(clips) > 1 else ""),
        ("copies", f"{result.copies:,} vertices lie on others in every frame: solved as one"),
    ][: 3 if result.copies else 2]
    if result.normals is not None:
        rows.append(("normals", f"{result.normals}, as engines draw them"))
    if "parsimony" in document:
        rows += in_words(document["parsimony"], _PARSIMONY)
        found = document["parsimony"]["prunings"]
        rows += [(pruning["what"], _PRUNING.format_map(pruning)) for pruning in found]
    rows.append(("ended", result.stop_reason))
    size = document["diagonal"], 0.01 * result.rmse  # less adds nothing to that
    return [*rows, *(("wrote", saved_line(r, *size)) for r in document["outputs"])]


def _draw(
    path: Path, result: Any, shots: list[MeshSequence], inputs: Sequence[Path], model: Path
) -> Any:
    """Write a page that shows the result beside the input, or a contact sheet."""
    from ..show import draw

    title = inputs[0].stem
    if path.suffix.lower() not in PAGES:
        draw(result.skinning, path, reference=joined(shots), title=title)
        return SaveReport(path=path, bytes=path.stat().st_size)
    name = ", ".join(source.name for source in inputs)
    file = model if model.is_file() else None
    return ssdr.view(result, shots, path, title=title, file=file, reference_name=name)
