"""The command ``ssdr smallest``."""

from __future__ import annotations

import contextlib
import dataclasses
from typing import Annotated, Any, Literal

from ..checks import parse_tolerance
from .fitting import fit
from .options import MODEL, RIG, FitOptions, option, takes


@dataclasses.dataclass(kw_only=True)
class SmallestOptions(FitOptions):
    """Arguments and options of ``ssdr smallest``."""

    tolerance: Annotated[
        str, option(MODEL, "A length in the mesh's units, or 0.5% of the diagonal.")
    ]
    rig: Annotated[
        Literal["loose", "rigid"] | None,
        option(RIG, "Connect the bones by joints that may come apart (loose) or not (rigid)."),
    ] = None
    measure: Annotated[
        Literal["rmse", "max"],
        option(MODEL, "Bound the RMSE, or the error of every vertex in every frame."),
    ] = "rmse"


@takes
def smallest(options: SmallestOptions) -> None:
    """Find the model with the fewest bones within an error tolerance.

    Options other than --tolerance and --measure are those of ssdr decompose.
    """
    import ssdr

    fit("smallest", ssdr.smallest, options, lambda: _arguments(options))


def _arguments(options: SmallestOptions) -> dict[str, Any]:
    """Arguments of :func:`ssdr.smallest` from those options that only this command has."""
    tolerance: str | float = options.tolerance
    with contextlib.suppress(ValueError):
        tolerance = float(tolerance)
    parse_tolerance(tolerance, 1.0)
    own = ("measure", "rig")
    return {"tolerance": tolerance, **{name: getattr(options, name) for name in own}}
