"""Options that several commands have, and the panels in which the help shows them."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import typer

MODEL, PICTURE, RIG, RUN, FILES = "Model", "Picture", "Rig", "Run", "Files"
_PANELS = (None, MODEL, PICTURE, RIG, RUN, FILES)  # in the order of the help
_PAIR = "[SUFFIX:]KEY=VALUE"


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
    fps: Annotated[float | None, option(FILES, "Frames per second of the inputs.")] = None
    weld: Annotated[
        bool, option(FILES, "Merge vertices that coincide in every frame (UV seams).", "--weld")
    ] = False
    read: Annotated[
        list[str] | None,
        option(FILES, "Option of ssdr.load, as scale=0.01; repeatable.", metavar=_PAIR),
    ] = None
    threads: Annotated[int | None, option(RUN, "Threads; all cores by default.", min=1)] = None
    json: Annotated[bool, option(FILES, "Print one JSON object and nothing else.", "--json")] = (
        False
    )
    quiet: Annotated[bool, option(FILES, "No progress and no table.", "--quiet", "-q")] = False
    verbose: Annotated[
        int, option(FILES, "Log on stderr; -vv for debugging.", "--verbose", "-v", count=True)
    ] = 0


Force = Annotated[bool, option(FILES, "Overwrite outputs that exist.", "--force", "-f")]
Write = Annotated[
    list[str] | None,
    option(FILES, "Option of ssdr.save, as glb:weights=uint16; repeatable.", metavar=_PAIR),
]


@dataclasses.dataclass(kw_only=True)
class FitOptions(Options):
    """Arguments and options of both ``ssdr decompose`` and ``ssdr smallest``."""

    inputs: Annotated[
        list[Path], argument("IN...", "Animated mesh; several files of one mesh are its clips.")
    ]
    outputs: Annotated[
        list[Path],
        option(FILES, "Result; repeat it for more formats.", "--output", "-o", metavar="OUT"),
    ]
    bones: Annotated[int | None, option(MODEL, "Number of bones.", "--bones", "-b", min=1)] = None
    influences: Annotated[
        int, option(MODEL, "Most bones that move one vertex.", "--influences", "-k", min=1)
    ] = 4
    effort: Annotated[
        Literal["fast", "balanced", "best"],
        option(MODEL, "Speed against accuracy.", "--effort", "-e"),
    ] = "balanced"
    bone_model: Annotated[
        Literal["rigid", "similarity", "affine"],
        option(MODEL, "similarity: bones also grow; affine: they also shear."),
    ] = "rigid"
    start: Annotated[
        str | None,
        option(
            RUN,
            "Go on from a model or checkpoint; or keep the first frame of a mesh as the rest pose; "
            "or start with the rest pose of frame N.",
            metavar="FILE|N",
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
    picture: Annotated[
        Path | None, option(FILES, "Draw a contact sheet as well.", metavar="PNG")
    ] = None
    write: Write = None
    force: Force = False


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
