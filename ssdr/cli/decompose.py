"""``ssdr decompose``."""

from __future__ import annotations

import dataclasses
from typing import Annotated

from ..errors import InputError
from .fitting import fit
from .options import MODEL, FitOptions, option, takes


@dataclasses.dataclass(kw_only=True)
class DecomposeOptions(FitOptions):
    """What ``decompose`` takes."""

    smoothness: Annotated[float, option(MODEL, "Smoothness of the weights.", min=0.0)] = 0.0


@takes
def decompose(options: DecomposeOptions) -> None:
    """Fit a rest pose, sparse skin weights and bones to an animated mesh.

    Several files of one mesh, or several clips of a file (--clip all), share rest pose
    and weights; each clip becomes an animation of its own.

    From glTF to glTF and from USD to USD, the file gets a new skin and keeps the rest of
    what it holds.

    Ctrl-C stops and saves the best model so far; a second Ctrl-C ends at once.
    """
    import ssdr

    if options.bones is None and options.rig in (None, "loose", "rigid"):
        raise InputError("--bones", "a number of bones, or --rig FILE", "neither")
    fit("decompose", ssdr.decompose, options, smoothness=options.smoothness)
