"""Options that several commands have, and the panels in which the help shows them."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import typer

from ..errors import InputError

MODEL, PICTURE, RIG, RUN, FILES = "Model", "Picture", "Rig", "Run", "Files"
_PANELS = (None, MODEL, PICTURE, RIG, RUN, FILES)  # in the order of the help
_PAIR = "[SUFFIX:]KEY=VALUE"
_OUTPUT = "Model; repeat it for other formats, a contact sheet (.png) or a page (.html)."
PAGES = (".html", ".htm")
_DRAWN = (*PAGES, ".png", ".jpg", ".jpeg", ".webp", ".gif", ".tif", ".tiff", ".bmp", ".pdf")


def option(panel: str, help: str, *names: str, **more: Any) -> Any:
    """Option in a panel of the help, named after its field unless `names` are given."""
    return typer.Option(*names, help=help, rich_help_panel=panel, **more)


def argument(metavar: str, help: str) -> Any:
    """Positional argument, named `metavar` in the help."""
    return typer.Argument(metavar=metavar, help=help)


@dataclasses.dataclass(kw_only=True)
class Options:
    """Options of every command."""

    clip: Annotated[
        list[str] | None, option(FILES, "Clip to read; repeat it, or say all.", metavar="NAME")
    ] = None
    read: Annotated[
        list[str] | None,
        option(FILES, "Option of ssdr.load, as fps=30 or weld=true; repeatable.", metavar=_PAIR),
    ] = None
    json: Annotated[bool, option(FILES, "Print one JSON object and nothing else.", "--json")] = (
        False
    )
    quiet: Annotated[bool, option(FILES, "No progress and no table.", "--quiet", "-q")] = False


@dataclasses.dataclass(kw_only=True)
class SpaceOptions(Options):
    """Options of every command that compares or writes coordinates."""

    units: Annotated[
        str | None,
        option(FILES, "Unit of the inputs, in place of what they state.", metavar="METRES|cm|mm|m"),
    ] = None
    up: Annotated[
        Literal["y", "z"] | None,
        option(FILES, "Up axis of the inputs, in place of what they state."),
    ] = None


# Existing files are overwritten anyway; scripts for earlier versions pass this option.
Force = Annotated[bool, option(FILES, "No effect.", "--force", "-f", hidden=True)]
Write = Annotated[
    list[str] | None,
    option(FILES, "Option of ssdr.save, as glb:weights=uint16; repeatable.", metavar=_PAIR),
]


@dataclasses.dataclass(kw_only=True)
class FitOptions(SpaceOptions):
    """Arguments and options of both ``ssdr decompose`` and ``ssdr smallest``.

    Of the outputs, `drawn` are the pages and pictures; only the models stay in `outputs`.
    """

    inputs: Annotated[
        list[Path], argument("IN...", "Animated mesh; several files of one mesh are its clips.")
    ]
    outputs: Annotated[
        list[Path],
        option(FILES, _OUTPUT, "--output", "-o", metavar="OUT"),
    ]
    drawn: list[Path] = dataclasses.field(init=False)
    bones: Annotated[int | None, option(MODEL, "Number of bones.", "--bones", "-b", min=1)] = None
    influences: Annotated[
        int, option(MODEL, "Most bones of a vertex.", "--influences", "-k", min=1)
    ] = 4
    effort: Annotated[
        Literal["fast", "balanced", "best"],
        option(MODEL, "Speed against accuracy.", "--effort", "-e"),
    ] = "balanced"
    bone_model: Annotated[
        Literal["rigid", "similarity", "affine"],
        option(MODEL, "similarity: bones also grow; affine: they also shear."),
    ] = "rigid"
    rest_pose: Annotated[
        Literal["surface", "free"],
        option(MODEL, "surface: the rest pose resembles a frame; free: it has the least error."),
    ] = "surface"
    normals: Annotated[
        bool, option(MODEL, "Whether the last steps fit the normals that engines draw, too.")
    ] = True
    start: Annotated[
        str | None,
        option(
            RUN,
            "Go on from a model or checkpoint; or keep the first frame of a mesh as the rest pose.",
            metavar="FILE",
        ),
    ] = None
    seed: Annotated[int, option(RUN, "The same seed gives the same result.", min=0)] = 0
    time_limit: Annotated[
        float | None,
        option(RUN, "Stop the solver after so long, and save its best model.", metavar="SECONDS"),
    ] = None
    checkpoint: Annotated[
        Path | None,
        option(RUN, "Save the best model so far here about every minute.", metavar="MODEL.npz"),
    ] = None
    write: Write = None
    force: Force = False

    def __post_init__(self) -> None:
        self.drawn = [path for path in self.outputs if path.suffix.lower() in _DRAWN]
        self.outputs = [path for path in self.outputs if path not in self.drawn]
        if not self.outputs:
            raise InputError("--output", "a file for the model, too", str(self.drawn[0]))


def takes(function: Callable[[Any], None]) -> Callable[..., None]:
    """Turn a function of one dataclass into a command whose options are the fields of the class."""
    (kind,) = (get_type_hints(function)[name] for name in inspect.signature(function).parameters)
    hints = get_type_hints(kind, include_extras=True)

    def panel(parameter: inspect.Parameter) -> tuple[int, bool]:
        """Sorting key: the panel in the help, then required options before others."""
        name = parameter.annotation.__metadata__[0].rich_help_panel
        return _PANELS.index(name), parameter.default is not parameter.empty

    parameters = [
        parameter.replace(annotation=hints[name])
        for name, parameter in inspect.signature(kind).parameters.items()
    ]

    @functools.wraps(function)
    def command(**given: Any) -> None:
        function(kind(**given))

    command.__annotations__ = hints
    command.__signature__ = inspect.Signature(sorted(parameters, key=panel))  # type: ignore[attr-defined]
    return command
