"""The commands that show: render and view."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import ssdr

from ..common.errors import InputError
from ..io.outputs import check_file
from ..show.drawing import draw
from .files import READ, check_page, files_of, pair, taken
from .output import Output, saved_line
from .parameters import passes


@passes(draw, *READ, without=["units", "weld", "path"])
def render(
    source: Path,
    *,
    output: Path,
    reference: Path | None = None,
    frames: str = "5",
    up: str | None = None,
    **options: Any,
) -> None:
    """Draw a contact sheet, one frame or a film; no display is needed.

    Parameters
    ----------
    source : Path
        A sequence or a skinning.
    output : Path
        The picture; .gif or .webp is a film.
    reference : Path, optional
        The true animation; shows the error.
    frames : str
        How many columns, or which frames as 0,10,20.
    up : str, optional
        Up axis, as x, y, z or with a minus; by default that of the file, or y.
    """
    from ..show.figures import picture_format

    picture_format(output)
    check_file(output, "output", others=[source] if reference is None else [source, reference])
    try:
        columns = [int(part) for part in frames.split(",")]
    except ValueError:
        expected = "a number, or frames such as 0,10,20"
        raise InputError("--frames", expected, repr(frames)) from None
    look = taken(options, draw)
    subject, truth = pair(source, reference, files_of(options)[0])
    with Output.current.progress_bar() as show:
        draw(
            subject,
            output,
            reference=truth,
            frames=columns if "," in frames else columns[0],
            up=up or subject.space.up or "y",
            callback=lambda done: show("drawing", done, ""),
            **look,
        )
    Output.current.result({"input": source, "output": output}, [("wrote", str(output))])


@passes(ssdr.view, *READ, without=["file", "reference_name", "units", "weld"])
def view(
    model: Path, reference: Path | None = None, *, output: Path | None = None, **options: Any
) -> None:
    """Show a model beside its input in the browser: one page, to be kept or sent.

    The page needs no network. It plays the animation, compares it with the input, colours it by
    texture, bone, weight or error, and turns the joints of a rigid tree.

    Parameters
    ----------
    model : Path
        A skinning or a sequence.
    reference : Path, optional
        The true animation.
    output : Path, optional
        The page; without it, a temporary one is opened.
    """
    if output is not None:
        check_page(output, [model] if reference is None else [model, reference])
    look = taken(options, ssdr.view)
    thing, truth = pair(model, reference, files_of(options)[0])
    look.setdefault("title", thing.name or model.stem)
    name = "" if reference is None else reference.name
    with Output.current.waiting("writing the page"):
        page = ssdr.view(thing, truth, output, file=model, reference_name=name, **look)
    document = {"input": model, **vars(page), "output": page.path}
    Output.current.result(document, [("page", saved_line(page))])
