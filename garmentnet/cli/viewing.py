"""The command ``garmentnet view``."""

from __future__ import annotations

import tempfile
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ssdr.common.errors import InputError

from .learning import entered_parameters

if TYPE_CHECKING:
    from ..data.parameters import SimulationParameters
    from ..runtime import LiveGarment
    from ..viewer import Take


def view(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL", help="Checkpoint of one network, or dress.")
    ],
    motions: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[MOTION...]", help="As for predict; else the one that ships."),
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
    from ..data.parameters import warn_beyond
    from ..runtime import load_live
    from ..viewer import write_page
    from .demo import DANCE

    if output is not None and output.suffix.lower() != ".html":
        raise InputError("--output", "a file .html", str(output))
    garment = load_live(model)
    entered = entered_parameters(bending, density, time_scale)
    if entered and not garment.reads_parameters:
        raise InputError("model", "one that reads the simulation's parameters", str(model))
    takes, parameters = _read(garment, motions or [DANCE], entered, truth)
    warn_beyond(parameters, ())
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


def _read(
    garment: LiveGarment, motions: list[Path], entered: dict[str, float], truth: bool
) -> tuple[list[Take], SimulationParameters]:
    """Motions of some files, and the simulation parameters.

    Those that were not entered are the usual ones, or those of the first clip if the network reads
    them.
    """
    import dataclasses

    from ..data.parameters import SimulationParameters
    from ..prediction.motion_file import read_motion
    from ..viewer import Take

    found = [read_motion(path, garment.subject) for path in motions]
    own = next((clip.parameters for _, clip in found if clip is not None and truth), None)
    reads = garment.reads_parameters
    known = dataclasses.asdict(own) if own and reads else {}
    parameters = SimulationParameters(**known | entered)
    trained_on = parameters if reads else garment.trained_on[0]
    takes = []
    for path, (joints, clip) in zip(motions, found, strict=True):
        cloth = None
        if clip is not None and truth:
            if trained_on in (None, clip.parameters):
                cloth = clip.sequence.frames(slice(None))
            else:
                typer.echo(f"{path}: its cloth is not shown, it is of {clip.parameters}", err=True)
        takes.append(Take(path.stem, joints, cloth))
    return takes, parameters
