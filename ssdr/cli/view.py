"""The command ``ssdr view``."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any

from ..errors import InputError
from ..skinning import Skinning
from .format_options import read_options
from .options import FILES, PAGES, PICTURE, Force, Options, argument, option, takes
from .output import Output, page_row
from .reading import read_model, read_truth
from .saving import check_file


@dataclasses.dataclass(kw_only=True)
class ViewOptions(Options):
    """Arguments and options of ``ssdr view``."""

    source: Annotated[Path, argument("MODEL", "A skinning or a sequence.")]
    reference: Annotated[Path | None, argument("INPUT", "The true animation.")] = None
    target: Annotated[
        Path | None,
        option(
            FILES, "The page; without it, a temporary one.", "--output", "-o", metavar="PAGE.html"
        ),
    ] = None
    open: Annotated[
        bool, option(FILES, "Open the page in the browser; the rule without -o.", "--open")
    ] = False
    no_input: Annotated[
        bool, option(FILES, "Measure against INPUT, but leave it out of the page.", "--no-input")
    ] = False
    max_mb: Annotated[
        float, option(FILES, "Largest size of the page in MB; frames give way.", min=0.001)
    ] = 64.0
    title: Annotated[str | None, option(PICTURE, "Heading; the name of the model by default.")] = (
        None
    )
    up: Annotated[str, option(PICTURE, "Up axis: x, y, z, or with a minus.")] = "y"
    force: Force = False


@takes
def view(options: ViewOptions) -> None:
    """Show a model beside its input in the browser: one page, to be kept or sent.

    The page needs no network. It plays the animation, compares it with the input, colours it by
    texture, bone, weight or error, and turns the joints of a rigid tree.
    """
    output = Output.start(options)
    import ssdr

    source, target, reference = options.source, options.target, options.reference
    sources = [source] if reference is None else [source, reference]
    if target is not None:
        check_page(target, "--output", others=sources)
    read = read_options(sources, options)
    with output.waiting(f"loading {source}"):
        model = read_model(source, options.clip, read[0])
        truth = None
        if reference is not None:
            clips = model.clips if isinstance(model, Skinning) else ()
            truth = read_truth(reference, clips, read[1])
    with output.waiting("writing the page"):
        page = ssdr.view(
            model,
            truth,
            target,
            title=options.title or model.name or source.stem,
            up=options.up,
            keep_input=not options.no_input,
            file=source,
            reference_name="" if reference is None else reference.name,
            max_bytes=round(1e6 * options.max_mb),
            open=options.open or target is None,
        )
    document: dict[str, Any] = {"command": "view", "input": source, **dataclasses.asdict(page)}
    output.result({**document, "output": page.path}, [page_row(page)])


def check_page(path: Path, option: str, *, others: list[Path]) -> None:
    """Raise an InputError before the work if a page could not be written to `path` after it."""
    if path.suffix.lower() not in PAGES:
        raise InputError(option, "a file ending in .html", str(path))
    check_file(path, option, others=others)
