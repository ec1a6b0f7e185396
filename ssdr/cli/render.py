"""The command ``ssdr render``."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any

from ..clips import one_rate
from ..errors import InputError
from ..skinning import Skinning
from .format_options import read_options
from .options import FILES, PICTURE, Force, Options, argument, option, takes
from .output import Output
from .reading import read_model, read_truth
from .saving import check_file

_STYLES = "plain|weights|bones|error|normals"


@dataclasses.dataclass(kw_only=True)
class RenderOptions(Options):
    """Arguments and options of ``ssdr render``."""

    source: Annotated[Path, argument("IN", "A sequence or a skinning.")]
    target: Annotated[
        Path,
        option(FILES, "A picture; .gif or .webp: a film.", "--output", "-o", metavar="OUT"),
    ]
    reference: Annotated[
        Path | None, option(FILES, "The true animation; shows the error.", "--reference", "-r")
    ] = None
    frames: Annotated[str, option(PICTURE, "How many columns, or which frames: 0,10,20.")] = "5"
    frame: Annotated[int | None, option(PICTURE, "One frame alone instead of a sheet.")] = None
    style: Annotated[
        list[str] | None,
        option(PICTURE, "Rows of the sheet; repeatable.", "--style", "-s", metavar=_STYLES),
    ] = None
    width: Annotated[
        int | None, option(PICTURE, "Pixels: by default 1600, for one frame 1000, for a film 480.")
    ] = None
    title: Annotated[str | None, option(PICTURE, "Heading of the sheet.")] = None
    up: Annotated[
        str | None,
        option(PICTURE, "Up axis: x, y, z, or with a minus; by default that of the file, or y."),
    ] = None
    azimuth: Annotated[float | None, option(PICTURE, "Degrees around; chosen by default.")] = None
    elevation: Annotated[float, option(PICTURE, "Degrees above.")] = 12.0
    force: Force = False


@takes
def render(options: RenderOptions) -> None:
    """Draw a contact sheet, one frame or a film; no display is needed."""
    output = Output.start(options)
    from ..render.figures import animate, contact_sheet, picture_format, render_frame, write_picture

    source, target, reference = options.source, options.target, options.reference
    film = target.suffix.lower() in (".gif", ".webp") and options.frame is None
    picture_format(target)
    sources = [source] if reference is None else [source, reference]
    check_file(target, "--output", others=sources)
    frames = _frames(options.frames)
    read = read_options(sources, options)
    with output.waiting(f"loading {source}"):
        subject = read_model(source, options.clip, read[0])
    clips = subject.clips if isinstance(subject, Skinning) else ()
    if film and clips and not one_rate(clips):
        rates = ", ".join(f"{c.name} at {c.fps:g}" for c in clips)
        raise InputError("--clip", "a clip, or some of one frame rate, for a film", rates)
    truth = None if reference is None else read_truth(reference, clips, read[1])
    look: dict[str, Any] = {
        "reference": truth,
        "up": options.up or subject.space.up or "y",
        "azimuth": options.azimuth,
        "elevation": options.elevation,
    }
    styles: Any = options.style or None
    if film:
        look |= {"style": styles, "frames": None if isinstance(frames, int) else frames}
        side = options.width or 480
        with output.progress_bar() as show:
            look["callback"] = lambda done: show("drawing", done, "")
            animate(subject, target, size=(side, side), **look)
    else:
        with output.waiting(f"drawing {target}"):
            if options.frame is None:
                look |= {"styles": styles, "frames": frames, "title": options.title}
                picture = contact_sheet(subject, width=options.width or 1600, **look)
            else:
                look["style"] = styles[0] if styles else "error" if truth is not None else None
                side = options.width or 1000
                picture = render_frame(subject, options.frame, size=(side, side), **look)
            write_picture(picture, target)
    document = {"command": "render", "input": source, "output": target}
    output.result(document, [("wrote", str(target))])


def _frames(text: str) -> int | list[int]:
    try:
        numbers = [int(part) for part in text.split(",")]
    except ValueError:
        raise InputError("--frames", "a number, or frames such as 0,10,20", repr(text)) from None
    return numbers if "," in text else numbers[0]
