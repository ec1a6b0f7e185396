"""The command ``garmentnet view``."""

from __future__ import annotations

import tempfile
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ssdr.errors import InputError

from .learning import entered_parameters

if TYPE_CHECKING:
    from ..data.parameters import SimulationParameters
    from ..data.subject import Subject
    from ..viewer import Take

# Name, seed and classes of motion of the dances that a page shows by default, and their length.
_DANCES = (
    ("dance", 1, None),
    ("walk and spin", 2, ("walk", "spin")),
    ("kick and jump", 3, ("kick", "jump")),
)
_SECONDS = 12


def view(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL", help="Checkpoint of one network, or dress.")
    ],
    motions: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[MOTION...]", help=".bvh, .npz or a clip; else three dances."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="page.html; without it, a temporary one."),
    ] = None,
    show: Annotated[
        bool, typer.Option("--open", help="Open the page in the browser; the rule without -o.")
    ] = False,
    bending: Annotated[float | None, typer.Option(help="Bending stiffness at first.")] = None,
    density: Annotated[float | None, typer.Option(help="kg/m².")] = None,
    time_scale: Annotated[float | None, typer.Option(help="Seconds of cloth per second.")] = None,
    truth: Annotated[
        bool, typer.Option(help="Show a clip's own cloth beside the prediction.")
    ] = True,
    max_mb: Annotated[float, typer.Option(help="Largest size of the page in MB.")] = 12.0,
) -> None:
    """Show a garment that the browser itself predicts: one page, to be kept or sent.

    The body dances or is turned by hand, the garment follows; a garment that reads the
    simulation's parameters has sliders for them.
    """
    from ..runtime import load_live
    from ..viewer import write_page

    if output is not None and output.suffix.lower() != ".html":
        raise InputError("--output", "a file .html", str(output))
    garment = load_live(model)
    entered = entered_parameters(bending, density, time_scale)
    if entered and not garment.reads_parameters:
        raise InputError("model", "one that reads the simulation's parameters", str(model))
    subject = garment.subject
    if motions:
        takes, parameters = _read(model, motions, entered, truth, garment.reads_parameters)
    else:
        takes, parameters = _dances(subject), _parameters(entered)
    path = output or Path(tempfile.mkdtemp(prefix="garmentnet-")) / "page.html"
    size = write_page(
        garment,
        takes,
        path,
        parameters=parameters,
        title=model.stem,
        max_bytes=round(1e6 * max_mb),
    )
    frames = sum(len(take.joints) for take in takes)
    typer.echo(f"{path}: {size / 1e6:.1f} MB, {len(takes)} motion(s), {frames} frames")
    if show or output is None:
        webbrowser.open(path.resolve().as_uri())


def _parameters(entered: dict[str, float]) -> SimulationParameters:
    from ..data.parameters import SimulationParameters

    parameters = SimulationParameters(**entered)
    for name in parameters.outside():
        typer.echo(f"warning: {name} {getattr(parameters, name):g} is beyond its slider", err=True)
    return parameters


def _dances(subject: Subject) -> list[Take]:
    from ..viewer import Take
    from .demo import made_dance

    return [
        Take(name, made_dance(subject, seed=seed, seconds=_SECONDS, classes=classes).joints)
        for name, seed, classes in _DANCES
    ]


def _read(
    model: Path, motions: list[Path], entered: dict[str, float], truth: bool, reads: bool
) -> tuple[list[Take], SimulationParameters]:
    """Motions of some files, and the simulation parameters.

    Parameters that are not entered are those of the first clip, if the garment reads them.
    """
    import dataclasses

    from ..networks.checkpoint import load_checkpoint
    from ..prediction.motion_file import read_motion
    from ..viewer import Take

    checkpoint = load_checkpoint(model)
    joints, found = zip(*(read_motion(path, checkpoint) for path in motions), strict=True)
    clips = [clip if truth else None for clip in found]
    own = next((clip.parameters for clip in clips if clip is not None), None)
    usual = dataclasses.asdict(own) if own and reads else {}
    parameters = _parameters(usual | entered)
    trained_on = parameters if reads else checkpoint.parameters[0]
    takes = []
    for path, moved, clip in zip(motions, joints, clips, strict=True):
        if clip is not None and trained_on is not None and clip.parameters != trained_on:
            typer.echo(f"{path}: its cloth is not shown, it is of {clip.parameters}", err=True)
            clip = None
        seen = None if clip is None else clip.sequence.frames(slice(None))
        takes.append(Take(path.stem, moved, seen))
    return takes, parameters
