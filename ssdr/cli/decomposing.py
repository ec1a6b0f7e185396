"""``ssdr decompose``."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from ..clips import names_of
from ..errors import Cancelled, InputError
from ..sequence import MeshSequence
from ..skinning import Skinning
from .assets import options_with_template
from .choices import BoneModel, Effort, Hierarchy, ToleranceOf
from .interruption import interrupted, rescue, state_beside, stopping
from .output import (
    Force,
    Fps,
    Interrupted,
    JsonFlag,
    Output,
    Quiet,
    ReadOptions,
    Scale,
    Strict,
    Threads,
    Verbose,
    Weld,
    WriteOptions,
    check_file,
    check_outputs,
    length_text,
    saved_document,
    saved_line,
    write_options,
)
from .progress import Reporter
from .reading import (
    ClipNames,
    check_rates,
    clips_document,
    clips_text,
    join,
    options_for,
    read_clips,
)
from .rigs import extra_bones_of, rest_pose, skeleton_parts
from .timing import frames_of_sheet, prepare, times_text

_NO_SHEAR = (".glb", ".gltf", ".usd", ".usda", ".usdc", ".fbx")


def decompose(
    inputs: Annotated[
        list[Path],
        typer.Argument(metavar="IN...", help="Animated mesh; several files of it are its clips."),
    ],
    outputs: Annotated[
        list[Path],
        typer.Option("--output", "-o", metavar="OUT", help="Result; repeat for several formats."),
    ],
    bones: Annotated[
        int | None,
        typer.Option("--bones", "-b", min=1, help="Number of bones; with --tolerance the most."),
    ] = None,
    influences: Annotated[
        int, typer.Option("--influences", "-k", min=1, help="Most bones that move one vertex.")
    ] = 4,
    tolerance: Annotated[
        str | None,
        typer.Option(
            "--tolerance",
            metavar="ERROR",
            help="Find the smallest model with at most this error: a length in the mesh's units, "
            "or a share of the diagonal such as 0.5%.",
        ),
    ] = None,
    tolerance_of: Annotated[
        ToleranceOf, typer.Option("--tolerance-of", help="What the tolerance bounds.")
    ] = ToleranceOf.rmse,
    effort: Annotated[
        Effort, typer.Option("--effort", "-e", help="Speed against accuracy.")
    ] = Effort.balanced,
    bone_model: Annotated[
        BoneModel, typer.Option("--bone-model", help="What bones may do.")
    ] = BoneModel.rigid,
    hierarchy: Annotated[
        Hierarchy, typer.Option("--hierarchy", help="Joints: none, loose or rigid ones.")
    ] = Hierarchy.none,
    skeleton: Annotated[
        Path | None,
        typer.Option("--skeleton", help="A rig whose joints, parents and names are kept."),
    ] = None,
    extra_bones: Annotated[
        str,
        typer.Option(
            "--extra-bones",
            metavar="N|NAME=N,...",
            help="Bones more than the skeleton has, anywhere or below bones of it.",
        ),
    ] = "0",
    lock: Annotated[
        str | None,
        typer.Option(
            "--lock", metavar="NAME,...", help="Joints that turn as the skeleton's file says."
        ),
    ] = None,
    keep_weights: Annotated[
        bool, typer.Option("--keep-weights", help="Keep the skeleton's weights and rest pose.")
    ] = False,
    rest: Annotated[
        Path | None, typer.Option("--rest", help="A mesh whose first frame is the rest pose.")
    ] = None,
    rest_frame: Annotated[
        int, typer.Option("--rest-frame", min=0, help="Frame at which the rest pose starts.")
    ] = 0,
    rng: Annotated[
        int, typer.Option("--rng", "--seed", min=0, help="Seed; the same seed, the same result.")
    ] = 0,
    time_limit: Annotated[
        float | None,
        typer.Option(
            "--time-limit",
            metavar="SECONDS",
            help="Finish within so long, loading and saving included.",
        ),
    ] = None,
    max_iterations: Annotated[
        int | None, typer.Option("--max-iterations", min=0, help="Stop after so many iterations.")
    ] = None,
    smoothness: Annotated[
        float, typer.Option("--smoothness", min=0.0, help="Smoothness of the weights on the mesh.")
    ] = 0.0,
    clip: ClipNames = None,
    weld: Weld = False,
    fps: Fps = None,
    scale: Scale = None,
    resume: Annotated[
        Path | None, typer.Option("--resume", metavar="STATE", help="Go on from a saved state.")
    ] = None,
    checkpoint: Annotated[
        Path | None,
        typer.Option(
            "--checkpoint",
            metavar="STATE",
            help="Save the state here every minute and at the end; by default only when "
            "interrupted, as OUT.state.npz.",
        ),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--picture", metavar="PNG", help="Draw a contact sheet as well.")
    ] = None,
    up: Annotated[str, typer.Option("--up", help="Up axis of the picture.")] = "y",
    read: ReadOptions = None,
    write: WriteOptions = None,
    strict: Strict = False,
    threads: Threads = None,
    force: Force = False,
    json: JsonFlag = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Fit a rest pose, sparse skin weights and bones to an animated mesh.

    Several files of one mesh, or several clips of a file (--clip all), share rest pose
    and weights; each clip becomes an animation of its own.

    glTF to glTF and USD to USD, the file comes out as itself with a new skin: what is not
    the mesh's skin stays as it is.

    Ctrl-C stops at the next safe point and saves a state that --resume takes up;
    a second Ctrl-C quits at once.
    """
    output = Output.start(json=json, quiet=quiet, verbose=verbose, threads=threads)
    began = output.began
    if time_limit is not None and not (math.isfinite(time_limit) and time_limit > 0):
        raise InputError("--time-limit", "seconds > 0", time_limit)
    if bones is None and tolerance is None and skeleton is None:
        raise InputError("--bones", "a number of bones, --tolerance or --skeleton", "none of them")
    extra = extra_bones_of(extra_bones)
    if skeleton is None and (extra or keep_weights or lock):
        given = "--extra-bones" if extra else "--lock" if lock else "--keep-weights"
        raise InputError(given, "--skeleton beside it", "none")
    if rest is not None and keep_weights:
        raise InputError("--rest", "none beside --keep-weights, which keeps the rig's", str(rest))
    wanted = _tolerance(tolerance, tolerance_of)
    options = options_for(inputs, read, fps=fps, weld=weld, scale=scale)
    sources = inputs if resume is None else [*inputs, resume]
    check_outputs(outputs, kind=Skinning, pairs=write, force=force, sources=sources)
    for path in outputs:
        if bone_model is BoneModel.affine and path.suffix.lower() in _NO_SHEAR:
            raise InputError(
                "--bone-model",
                f"rigid or similarity for {path}, whose joints cannot shear (.npz holds any)",
                bone_model.value,
            )
        limited = path.suffix.lower() in (".glb", ".gltf")
        if (
            limited
            and min(influences, bones or influences) > 8
            and "influences" not in write_options(write, path)
        ):
            raise InputError(
                "--influences",
                f"at most 8 for {path} (--write {path.suffix[1:]}:influences=8 keeps the largest)",
                influences,
            )
    state_path = checkpoint or state_beside(outputs[0])
    if checkpoint is not None and checkpoint.suffix.lower() != ".npz":
        raise InputError("--checkpoint", "a file ending in .npz", str(checkpoint))
    # A run may be cut into several that hand one state on.
    mine = resume is not None and state_path.resolve() == resume.resolve()
    if not mine:
        anyway = force or checkpoint is None
        others = {path.resolve() for path in outputs}
        check_file(state_path, "--checkpoint", force=anyway, sources=inputs, seen=others)
    if picture is not None:
        from ..render.figures import picture_format
        from ..render.raster import up_axes

        picture_format(picture)
        up_axes(up)
        check_file(picture, "--picture", force=force, sources=sources)
    import ssdr

    start = None
    if resume is not None:
        if not resume.is_file():
            raise FileNotFoundError(f"{resume}: no such file")
        start = ssdr.SolverState.load(resume)
    parts = skeleton_parts(skeleton, extra, keep_weights, lock)
    loaded = time.perf_counter()
    with output.waiting(f"loading {', '.join(map(str, inputs))}"):
        shots = read_clips(inputs, clip, options)
    if sum(len(shot) for shot in shots) == 1:
        files = ", ".join(map(str, inputs))
        raise InputError(
            "IN", "an animation", f"one frame, {files} (no motion: did you mean a pattern?)"
        )
    check_rates(outputs, shots)
    if rest is not None:
        parts["rest"] = rest_pose(rest, shots[0], read, weld=weld, scale=scale)
    loading = time.perf_counter() - loaded
    clips = names_of(shots)["clips"]
    settings = {
        path: options_with_template(
            path,
            write,
            inputs,
            options,
            strict=strict,
            new_bones=True,
            clips=[one.name for one in clips],
        )
        for path in outputs
    }
    left, compiling, panel = prepare(
        shots,
        settings,
        clips=clips,
        bones=bones,
        picture=picture,
        time_limit=time_limit,
        began=began,
        output=output,
    )
    solved = time.perf_counter()

    with Reporter(show=not (quiet or json), stream=sys.stderr) as reporter, stopping() as stop:

        def follow(progress: Any) -> bool:
            reporter.update(progress)
            return stop.asked

        try:
            result = ssdr.decompose(
                shots[0] if len(shots) == 1 else shots,
                bones=bones,
                influences=influences,
                effort=effort.value,
                bone_model=bone_model.value,
                hierarchy=None if hierarchy is Hierarchy.none and skeleton else hierarchy.value,
                rest_frame=rest_frame,
                rng=rng,
                time_limit=left,
                max_iterations=max_iterations,
                smoothness=smoothness,
                resume=start,
                checkpoint=checkpoint,
                callback=follow,
                **wanted,
                **parts,
            )
        except Cancelled as error:
            raise Interrupted("interrupted before there was a model to save") from error
    written = [*outputs, *([picture] if picture is not None else [])]
    if result.stop_reason == "cancelled":
        raise interrupted(result, state_path, output, written)
    solving = time.perf_counter() - solved
    saving = time.perf_counter()

    reports = []
    try:
        for path in outputs:
            with output.waiting(f"saving {path}"):
                reports.append(ssdr.save(result.skinning, path, **settings[path]))
        if picture is not None:
            from ..render.figures import contact_sheet, write_picture

            columns = frames_of_sheet(time_limit, began, panel)
            with output.waiting(f"drawing {picture}"):
                sheet = contact_sheet(
                    result.skinning,
                    reference=join(shots),
                    frames=columns,
                    title=inputs[0].stem,
                    up=up,
                )
                write_picture(sheet, picture)
    except KeyboardInterrupt:
        raise interrupted(result, state_path, output, written) from None
    except Exception as error:
        # What was computed must survive a full disk or a format's limits.
        rescue(error, result.state, state_path, output, written)
        raise

    saving = time.perf_counter() - saving
    compiling += result.compile_seconds
    diagonal = max(shot.diagonal() for shot in shots)
    e = 1000 * result.rmse / math.sqrt(3)
    share = result.rmse / diagonal if diagonal > 0 else math.nan
    document = {
        "command": "decompose",
        "version": ssdr.__version__,
        "input": inputs[0] if len(inputs) == 1 else inputs,
        "frames": sum(len(shot) for shot in shots),
        "vertices": shots[0].n_vertices,
        "triangles": len(shots[0].faces),
        "clips": clips_document(clips),
        "bones": result.skinning.n_bones,
        "influences": result.skinning.n_influences,
        "effort": effort.value,
        "rng": rng,
        "rmse": result.rmse,
        "rmse_percent": 100 * share,
        "E": e,
        "diagonal": diagonal,
        "seconds": solving,
        "load_seconds": loading,
        "save_seconds": saving,
        "compile_seconds": compiling,
        "total_seconds": time.perf_counter() - began,
        **_pruned_document(result),
        "converged": result.converged,
        "stop_reason": result.stop_reason,
        "iterations": result.history[-1].iteration if result.history else 0,
        "outputs": [saved_document(report) for report in reports],
        "picture": picture,
        "state": checkpoint,
    }
    total = time.perf_counter() - began
    rows = [
        ("input", f"{', '.join(map(str, inputs))}: {_counts(shots, diagonal)}"),
        ("clips", clips_text(clips) if len(clips) > 1 else ""),
        ("model", f"{result.skinning.n_bones} bones, {result.skinning.n_influences} influences"),
        ("RMSE", f"{result.rmse:.4g} in the mesh's units, {100 * share:.3g} % of the diagonal"),
        ("E", f"{e:.4g} = 1000 · RMSE / √3"),
        *_pruned_rows(result, diagonal),
        ("time", times_text(total, loading, compiling, solving, saving)),
        ("stopped", f"{result.stop_reason}{'' if result.converged else ' (not converged)'}"),
        *[("wrote", saved_line(report, diagonal)) for report in reports],
        ("picture", str(picture or "")),
        ("state", str(checkpoint or "")),
    ]
    output.result(document, rows)


def _counts(shots: list[MeshSequence], diagonal: float) -> str:
    return (
        f"{sum(len(shot) for shot in shots):,} frames, {shots[0].n_vertices:,} vertices, "
        f"{len(shots[0].faces):,} triangles, diagonal {length_text(diagonal, None)}"
    )


def _tolerance(text: str | None, of: ToleranceOf) -> dict[str, Any]:
    """What the solver is told of a tolerance, refused here if it is none."""
    if text is None:
        # refused by the solver, as nothing that it would bound
        return {} if of is ToleranceOf.rmse else {"tolerance_of": of.value}
    from ..checks import parse_tolerance

    value: str | float = text
    with contextlib.suppress(ValueError):
        value = float(text)
    parse_tolerance(value, 1.0)
    return {"tolerance": value, "tolerance_of": of.value}


def _pruned_document(result: Any) -> dict[str, Any]:
    found = getattr(result, "parsimony", None)
    if found is None:
        return {}
    return {
        "tolerance": found.tolerance,
        "tolerance_of": found.tolerance_of,
        "tolerance_error": found.error,
        "held": found.held,
        "least_bones": found.least_bones,
        "bytes": found.size.total,
        "bytes_of": dataclasses.asdict(found.size),
        "prunings": [dataclasses.asdict(pruning) for pruning in found.prunings],
    }


def _pruned_rows(result: Any, diagonal: float) -> list[tuple[str, str]]:
    found = getattr(result, "parsimony", None)
    if found is None:
        return []

    def share(value: float) -> str:
        return f"{value:.3g}" + (f" ({100 * value / diagonal:.2g} %)" if diagonal > 0 else "")

    word = "held" if found.held else "not held"
    size = found.size
    kind = {"rmse": "RMSE", "max": "largest error"}[found.tolerance_of]
    rows = [
        ("tolerance", f"{word}: {kind} {share(found.error)} of {share(found.tolerance)}"),
        (
            "size",
            f"{size.total:,} bytes in an engine: rest pose {size.rest:,}, weights "
            f"{size.weights:,}, joints {size.joints:,}, keys {size.keys:,}; "
            "files hold more, such as triangles, UVs and textures",
        ),
    ]
    for p in found.prunings:
        saved = p.bytes_before - p.bytes_after
        rows.append(
            (p.what, f"{p.before:,} to {p.after:,}, {saved:,} bytes less; error {p.cost:+.2g}")
        )
    return rows
