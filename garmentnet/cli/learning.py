"""The commands ``garmentnet train, evaluate, predict, demo``."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from ssdr.errors import InputError

from .progress import progress_bar

__all__ = ["demo", "evaluate", "output_folder", "predict", "train"]


def output_folder() -> Path:
    """Folder for data and checkpoints: ``$GARMENTNET_DATA``, else ``out`` in the working folder."""
    return Path(os.environ.get("GARMENTNET_DATA") or "out")


def train(
    config: Annotated[
        str, typer.Argument(metavar="CONFIG", help="A .toml, or a preset: faithful, rooted.")
    ] = "faithful",
    store: Annotated[
        Path | None, typer.Option("--store", "-s", help="Folder of clips; else data.store.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder of the run.")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="Instead of train.seed.")] = None,
    ensemble: Annotated[
        bool, typer.Option("--ensemble", help="A network for every training set, and the kernel.")
    ] = False,
    start: Annotated[
        Path | None,
        typer.Option("--start", help="Checkpoint to start from; the base of --ensemble."),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="SECTION.NAME=VALUE", help="Change a setting; repeatable."),
    ] = None,
) -> None:
    """Train networks on a store; the same command again goes on where it was stopped."""
    from ..configs.config import load_config, override
    from ..data.store import ClipStore
    from ..networks.checkpoint import load_checkpoint
    from ..training.ensemble import train_ensemble
    from ..training.run import train as train_network

    changes = list(settings or [])
    if seed is not None:
        changes.append(f"train.seed={seed}")
    chosen = override(load_config(config), changes)
    source = store or (Path(chosen.data.store) if chosen.data.store else None)
    if source is None:
        raise InputError("--store", "a folder of clips, here or as data.store", "nothing")
    clips = ClipStore.open(source)
    stem = Path(config).stem + ("-ensemble" if ensemble else "") + f"-seed{chosen.train.seed}"
    folder = output or output_folder() / "runs" / stem
    with progress_bar() as show:
        if ensemble:
            path = train_ensemble(
                clips,
                chosen,
                folder,
                base=load_checkpoint(start) if start else None,
                callback=lambda name, p: show(f"{name}, {_epoch(p)}", p.fraction, p.time_left),
                progress=lambda text, done: show(text, done, None),
            )
        else:
            path = train_network(
                clips,
                chosen,
                folder,
                start=load_checkpoint(start) if start else None,
                callback=lambda p: show(_epoch(p), p.fraction, p.time_left),
                progress=lambda text, done: show(text, done, None),
            )
    typer.echo(str(path))


def evaluate(
    checkpoints: Annotated[
        list[Path], typer.Argument(metavar="CHECKPOINT...", help="One or more to compare.")
    ],
    store: Annotated[Path, typer.Option("--store", "-s", help="Folder of clips.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder for tables and pictures.")
    ] = None,
    baselines: Annotated[
        bool, typer.Option(help="Train and score what the networks must beat.")
    ] = True,
    pictures: Annotated[int, typer.Option(help="Test clips to draw, per checkpoint.")] = 1,
    clips: Annotated[
        list[str] | None,
        typer.Option("--clips", metavar="PATTERN", help="As 'base-small-*'; repeatable."),
    ] = None,
    against: Annotated[
        str | None, typer.Option(metavar="NAME", help="Method that the others are divided by.")
    ] = None,
    push_out: Annotated[
        bool, typer.Option("--push-out", help="Score with vertices moved out of the body too.")
    ] = False,
) -> None:
    """The paper's table on unseen motions and unseen parameters, beside baselines and floors."""
    from ..data.store import ClipStore
    from ..evaluation.reporting import report

    folder = output or output_folder() / "evaluation"
    with progress_bar() as show:
        text = report(
            checkpoints,
            ClipStore.open(store),
            folder,
            baselines=baselines,
            pictures=pictures,
            clips=clips or (),
            against=against,
            push_out=push_out,
            progress=lambda name, done: show(name, done, None),
        )
    typer.echo(text)
    typer.echo(str(folder))


def predict(
    checkpoint: Annotated[Path, typer.Argument(metavar="CHECKPOINT")],
    motion: Annotated[Path, typer.Argument(metavar="MOTION", help=".bvh, .npz or a clip.")],
    output: Annotated[
        list[Path],
        typer.Option("--output", "-o", help="out.{mp4,gif,png,glb,usda,pc2,npz}; repeatable."),
    ],
    bending: Annotated[float | None, typer.Option(help="Bending stiffness.")] = None,
    density: Annotated[float | None, typer.Option(help="kg/m².")] = None,
    time_scale: Annotated[float | None, typer.Option(help="Seconds of cloth per second.")] = None,
    detail: Annotated[bool, typer.Option(help="Run the high-frequency module.")] = True,
    truth: Annotated[
        bool, typer.Option(help="Show a clip's own cloth beside the prediction.")
    ] = True,
    error: Annotated[bool, typer.Option(help="Show the error in films of a clip, too.")] = False,
    every: Annotated[int, typer.Option(help="Every n-th frame alone in films.")] = 1,
    push_out: Annotated[
        bool, typer.Option(help="Move vertices that lie inside the body out of it.")
    ] = True,
) -> None:
    """Dress a motion: from a checkpoint and a motion to meshes, a film or pictures."""
    import warnings

    from ssdr.errors import SsdrWarning

    from ..data.parameters import SimulationParameters
    from ..networks.checkpoint import load_checkpoint
    from ..prediction.motion_file import read_clip, read_joints
    from ..prediction.output import check_output, save_prediction
    from ..prediction.prediction import predict as run

    for path in output:
        check_output(path)
    model = load_checkpoint(checkpoint)
    options = {"bending": bending, "density": density, "time_scale": time_scale}
    entered = {k: v for k, v in options.items() if v is not None}
    several = model.kernel is not None or model.networks[0].condition
    trained_on = None if several else model.parameters[0]
    usual = {k: getattr(trained_on, k) for k in options} if trained_on else {}
    parameters = SimulationParameters(**(usual | entered)) if entered or several else None
    joints = read_joints(motion, model)
    clip = read_clip(motion, model) if truth else None
    began = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", SsdrWarning)
        result = run(model, joints, parameters, detail=detail, push_out=push_out, name=motion.stem)
    for warning in caught:
        if issubclass(warning.category, SsdrWarning):
            typer.echo(f"warning: {warning.message}", err=True)
        else:
            warnings.warn_explicit(
                warning.message, warning.category, warning.filename, warning.lineno
            )
    seconds = time.perf_counter() - began
    rate = 1e3 * seconds / len(joints)
    shown = parameters or trained_on
    of = f" of {shown}" if shown else ""
    typer.echo(f"{len(joints)} frames{of} in {seconds:.1f} s, {rate:.1f} ms a frame", err=True)
    if clip is not None and shown is not None and clip.parameters != shown:
        typer.echo(f"the clip's cloth is not shown: it is of {clip.parameters}", err=True)
        clip = None
    if push_out:
        typer.echo(
            f"pushed out of the body: {100 * result.moved:.2f} % of the vertices moved, "
            f"at most {1e3 * result.farthest:.1f} mm",
            err=True,
        )
    for path in output:
        with progress_bar() as show:
            text = save_prediction(
                result,
                path,
                truth=clip,
                error=error,
                every=every,
                progress=lambda done: show("drawing", done, None),
            )
        typer.echo(f"{path}: {text}")


def demo(
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder; ./out/demo by default.")
    ] = None,
) -> None:
    """Simulate, decompose, train for a moment, predict and draw, in a few minutes."""
    from .demo import run_demo

    with progress_bar() as show:
        done = run_demo(output or output_folder() / "demo", progress=show)
    typer.echo(json.dumps(done, indent=1))


def _epoch(p: Any) -> str:
    best = f"{1e3 * p.rmse:.1f} mm" if p.rmse < float("inf") else "not validated yet"
    return f"{p.phase} {p.epoch}, loss {p.loss:.4g}, best {best}"
