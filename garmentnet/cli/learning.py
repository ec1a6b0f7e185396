"""The commands ``garmentnet train, evaluate, predict, export, demo``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from ssdr.common.errors import InputError

from .progress import log, progress_bar

Folder = Annotated[Path | None, typer.Option("--output", "-o", help="Folder; else one in ./out.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="SECTION.NAME=VALUE", help="Change a setting; repeatable."),
]


Parameters = Annotated[
    str, typer.Option(help="Of the simulation: bending=0.5,density=0.2,time_scale=1.")
]


def entered_parameters(text: str) -> dict[str, Any]:
    """Simulation parameters that were given as an option, by name."""
    from ..io.tables import parse_toml

    return parse_toml(text.replace(",", "\n"), "--parameters")


def output_folder() -> Path:
    """Folder for data and checkpoints: ``$GARMENTNET_DATA``, else ``out`` in the working folder."""
    return Path(os.environ.get("GARMENTNET_DATA") or "out")


def train(
    store: Annotated[Path, typer.Option("--store", "-s", help="Folder of clips.")],
    config: Annotated[
        str, typer.Argument(metavar="CONFIG", help="A .toml, or a preset: faithful, rooted, tiny.")
    ] = "faithful",
    output: Folder = None,
    ensemble: Annotated[
        bool, typer.Option("--ensemble", help="A network for every training set, and the kernel.")
    ] = False,
    settings: Settings = None,
) -> None:
    """Train networks on a store; the same command again goes on where it was stopped."""
    from ..configs.config import load_config, override
    from ..data.store import ClipStore
    from ..evaluation.verdict import verdict
    from ..paper.train import train as train_network
    from ..paper.train import train_ensemble

    chosen = override(load_config(config), settings or ())
    clips = ClipStore.open(store)
    if refused := clips.refused():
        typer.echo(refused, err=True)
    stem = Path(config).stem + ("-ensemble" if ensemble else "") + f"-seed{chosen.train.seed}"
    folder = output or output_folder() / "runs" / stem
    log()
    with progress_bar() as show:
        run = train_ensemble if ensemble else train_network
        path = run(clips, chosen, folder, progress=show)
        compared = "" if ensemble else verdict(path, clips, progress=show)
    if compared:
        typer.echo(compared, err=True)
    typer.echo(str(path))


def evaluate(
    checkpoints: Annotated[
        list[Path], typer.Argument(metavar="CHECKPOINT...", help="One or more to compare.")
    ],
    store: Annotated[Path, typer.Option("--store", "-s", help="Folder of clips.")],
    output: Folder = None,
    baselines: Annotated[
        bool, typer.Option(help="Fit and score what the networks must beat.")
    ] = True,
    pictures: Annotated[int, typer.Option(help="Test clips to draw, per checkpoint.")] = 1,
    clips: Annotated[
        list[str] | None,
        typer.Option("--clips", metavar="PATTERN", help="As 'base-dance-220*'; repeatable."),
    ] = None,
) -> None:
    """Score networks on unseen motions and parameters as the paper does, beside baselines."""
    from ..data.store import ClipStore
    from ..evaluation.reporting import report

    folder, source = output or output_folder() / "evaluation", ClipStore.open(store)
    if refused := source.refused():
        typer.echo(refused, err=True)
    with progress_bar() as show:
        text = report(
            checkpoints,
            source,
            folder,
            baselines=baselines,
            pictures=pictures,
            clips=clips or (),
            progress=show,
        )
    typer.echo(text)
    typer.echo(str(folder))


def predict(
    checkpoint: Annotated[Path, typer.Argument(metavar="CHECKPOINT")],
    motion: Annotated[
        Path, typer.Argument(metavar="MOTION", help=".glb, .fbx, .usd, .npz or a clip.")
    ],
    output: Annotated[
        list[Path],
        typer.Option("--output", "-o", help="out.{html,webp,png,glb,usda,pc2,npz}; repeatable."),
    ],
    parameters: Parameters = "",
    detail: Annotated[bool, typer.Option(help="Run the high-frequency module.")] = True,
    every: Annotated[int, typer.Option(min=1, help="Draw only every n-th frame in films.")] = 1,
    push_out: Annotated[
        bool, typer.Option(help="Move vertices that lie inside the body out of it.")
    ] = True,
) -> None:
    """Dress a motion: from a checkpoint and a motion to meshes, a film or pictures."""
    from ..networks.checkpoint import load_checkpoint
    from ..prediction.motion_file import read_motion
    from ..prediction.output import check_outputs, save_prediction
    from ..prediction.prediction import chosen_parameters
    from ..prediction.prediction import predict as run

    model = load_checkpoint(checkpoint)
    chosen = chosen_parameters(model, entered_parameters(parameters))
    joints, clip = read_motion(motion, model.subject)
    check_outputs(output, [motion, checkpoint], frames=len(joints))
    result = run(model, joints, chosen, detail=detail, push_out=push_out, name=motion.stem)
    shown = chosen or model.parameters[0]
    of = f" of {shown}" if shown else ""
    typer.echo(f"{len(joints)} frames{of}", err=True)
    if clip is not None and shown is not None and clip.parameters != shown:
        typer.echo(f"the clip's cloth is not shown: it is of {clip.parameters}", err=True)
        clip = None
    if pushed := result.pushed:
        typer.echo(
            f"pushed out of the body: {100 * pushed.moved:.2f} % of the vertices moved by more "
            f"than 5 mm, at most {1e3 * pushed.farthest:.1f} mm",
            err=True,
        )
    elif push_out:
        typer.echo("nothing is pushed out: the body has no closed mesh", err=True)
    for path in output:
        with progress_bar() as show:
            text = save_prediction(result, path, truth=clip, every=every, progress=show)
        typer.echo(f"{path}: {text}")


def export(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="Checkpoint, or dress.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="dress.onnx")],
) -> None:
    """Write a network as .onnx, which engines run; `garmentnet predict` writes a .glb to play."""
    from ssdr.io.outputs import check_file

    from ..networks.checkpoint import load_checkpoint
    from ..runtime.onnx_file import export_onnx

    if output.suffix.lower() != ".onnx":
        raise InputError("--output", "a file .onnx", str(output))
    check_file(output, "--output", others=[model])
    path = export_onnx(load_checkpoint(model), output)
    typer.echo(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


def demo(output: Folder = None) -> None:
    """Dress a dance with the garment that ships: pictures, film and meshes within a minute."""
    from ..data.parameters import SimulationParameters
    from ..io.tensors import SHIPPED
    from ..networks.checkpoint import load_checkpoint
    from ..prediction.motion_file import read_motion
    from ..prediction.output import save_prediction
    from ..prediction.prediction import predict as run

    folder = output or output_folder() / "demo"
    folder.mkdir(parents=True, exist_ok=True)
    with progress_bar() as show:
        show("predicting", 0.0)
        checkpoint = load_checkpoint("dress")
        # Four seconds of a generated dance: sway, spin, kick, walk.
        joints, _ = read_motion(SHIPPED / "dance.npz", checkpoint.subject)
        result = run(checkpoint, joints, SimulationParameters(), name="dress")
        files = [folder / f"dress.{suffix}" for suffix in ("png", "npz", "webp", "glb")]
        for path in files:
            save_prediction(result, path, size=360, every=2, progress=show)
    typer.echo("\n".join(map(str, files)))
