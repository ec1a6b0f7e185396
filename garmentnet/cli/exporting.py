"""The command ``garmentnet export``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ssdr.common.errors import InputError

from .learning import entered_parameters


def export(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="Checkpoint, or dress.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="dress.onnx, .glb or .gltf")],
    bits: Annotated[int, typer.Option(help="Of an .onnx: of stored weights, 32 or 16.")] = 32,
    motion: Annotated[
        Path | None, typer.Option(help="Of a .glb: a file as for predict; else the one that ships.")
    ] = None,
    shapes: Annotated[int, typer.Option(help="Of a .glb: morph targets, at most.")] = 8,
    push_out: Annotated[
        bool, typer.Option(help="Of a .glb: move vertices inside the body out of it.")
    ] = True,
    bending: Annotated[float | None, typer.Option(help="Of a .glb.")] = None,
    density: Annotated[float | None, typer.Option(help="Of a .glb; kg/m².")] = None,
    time_scale: Annotated[float | None, typer.Option(help="Of a .glb.")] = None,
) -> None:
    """Write a garment for engines: .onnx predicts there, .glb plays one motion."""
    from ..networks.checkpoint import load_checkpoint

    suffix = output.suffix.lower()
    if suffix == ".onnx":
        from ..runtime.onnx_file import export_onnx

        path = export_onnx(load_checkpoint(model), output, bits=bits)
        typer.echo(f"{path}: {path.stat().st_size / 1e6:.1f} MB, {bits}-bit weights")
        return
    if suffix not in (".glb", ".gltf"):
        raise InputError("--output", "a file .onnx, .glb or .gltf", str(output))
    from ..prediction.motion_file import read_motion
    from ..prediction.prediction import chosen_parameters, predict
    from ..prediction.rigged import rigged, save_rigged
    from .demo import DANCE

    checkpoint = load_checkpoint(model)
    parameters = chosen_parameters(checkpoint, entered_parameters(bending, density, time_scale))
    subject = checkpoint.subject
    joints, _ = read_motion(motion or DANCE, subject)
    name = motion.stem if motion else "dance"
    result = predict(checkpoint, joints, parameters, push_out=push_out, name=name)
    typer.echo(f"{output}: {save_rigged(rigged(result, subject.skeleton, shapes=shapes), output)}")
