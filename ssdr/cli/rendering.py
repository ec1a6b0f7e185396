"""``ssdr render``."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from ..clips import Clip, one_rate
from ..errors import InputError
from ..sequence import MeshSequence
from ..skinning import Skinning
from .output import (
    Force,
    Fps,
    JsonFlag,
    Output,
    Quiet,
    ReadOptions,
    Threads,
    Verbose,
    check_file,
)
from .reading import ClipNames, clips_in, join, options_for, read_clips, read_model

_FILMS = (".gif", ".webp")


class PictureStyle(StrEnum):
    """What a picture shows."""

    plain = "plain"
    weights = "weights"
    bones = "bones"
    error = "error"


def render(
    source: Annotated[Path, typer.Argument(metavar="IN", help="A sequence or a skinning.")],
    target: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="OUT", help="A picture; .gif or .webp: a film."),
    ],
    reference: Annotated[
        Path | None,
        typer.Option("--reference", "-r", metavar="SEQ", help="What it should be: an error map."),
    ] = None,
    frames: Annotated[
        str, typer.Option("--frames", help="How many columns, or which frames: 0,10,20.")
    ] = "5",
    frame: Annotated[
        int | None, typer.Option("--frame", help="One frame alone instead of a sheet.")
    ] = None,
    styles: Annotated[
        list[PictureStyle] | None,
        typer.Option("--style", "-s", help="Rows of the sheet, or what to show; repeatable."),
    ] = None,
    width: Annotated[
        int | None,
        typer.Option("--width", help="Pixels: 1600, one frame 1000, a film's panel 480."),
    ] = None,
    title: Annotated[str | None, typer.Option("--title", help="Heading of the sheet.")] = None,
    up: Annotated[str, typer.Option("--up", help="Up axis: x, y, z, or with a minus.")] = "y",
    azimuth: Annotated[
        float | None, typer.Option("--azimuth", help="Degrees around; chosen by default.")
    ] = None,
    elevation: Annotated[float, typer.Option("--elevation", help="Degrees above.")] = 12.0,
    parallel: Annotated[bool, typer.Option("--parallel", help="Parallel projection.")] = False,
    clip: ClipNames = None,
    fps: Fps = None,
    read: ReadOptions = None,
    threads: Threads = None,
    force: Force = False,
    json: JsonFlag = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Draw a contact sheet, one frame or a film; no display is needed."""
    output = Output.start(json=json, quiet=quiet, verbose=verbose, threads=threads)
    from ..render.figures import contact_sheet, picture_format, render_frame, write_picture
    from ..render.film import animate
    from ..render.raster import up_axes

    up_axes(up)
    film = target.suffix.lower() in _FILMS
    if film and frame is not None:
        raise InputError("--frame", "a picture such as .png", str(target))
    picture_format(target)
    sources = [p for p in (source, reference) if p is not None]
    check_file(target, "--output", force=force, sources=sources)
    columns = _frames(frames)
    options = options_for(sources, read, fps=fps)
    with output.waiting(f"loading {source}"):
        subject = read_model(source, clip, options[0])
    clips = subject.clips if isinstance(subject, Skinning) else ()
    if film and clips and not one_rate(clips):
        rates = ", ".join(f"{c.name} at {c.fps:g}" for c in clips)
        raise InputError("--clip", "a clip, or some of one frame rate, for a film", rates)
    truth = None if reference is None else _truth(reference, clips, options[1])
    look: dict[str, Any] = {
        "reference": truth,
        "up": up,
        "azimuth": azimuth,
        "elevation": elevation,
        "perspective": not parallel,
    }
    chosen: Any = [s.value for s in styles] if styles else None
    if film:
        side = width or 480
        picked = None if isinstance(columns, int) else columns
        show = sys.stderr.isatty() and not (quiet or json)

        def follow(done: float) -> None:
            if show:
                sys.stderr.write(f"\r{100 * done:3.0f} %" + ("\n" if done == 1 else ""))

        animate(
            subject,
            target,
            style=chosen,
            size=(side, side),
            frames=picked,
            callback=follow,
            **look,
        )
    elif frame is not None:
        side = width or 1000
        style: Any = chosen[0] if chosen else ("error" if truth is not None else None)
        with output.waiting(f"drawing {target}"):
            shot = render_frame(subject, frame, style=style, size=(side, side), **look)
            write_picture(shot, target)
    else:
        with output.waiting(f"drawing {target}"):
            sheet = contact_sheet(
                subject, frames=columns, styles=chosen, width=width or 1600, title=title, **look
            )
            write_picture(sheet, target)
    document = {"command": "render", "input": source, "output": target}
    output.result(document, [("wrote", str(target))])


def _truth(path: Path, clips: tuple[Clip, ...], options: dict[str, Any]) -> MeshSequence:
    """What the subject should be: the same clips, where the file has several."""
    several = len(clips_in(path, options) or ()) > 1
    names = [clip.name for clip in clips] if several and clips else None
    return join(read_clips([path], names, [options]))


def _frames(text: str) -> int | list[int]:
    try:
        numbers = [int(part) for part in text.split(",")]
    except ValueError:
        raise InputError("--frames", "a number, or frames such as 0,10,20", repr(text)) from None
    return numbers if "," in text else numbers[0]
