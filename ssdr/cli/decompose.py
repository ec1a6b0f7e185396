"""The command ``ssdr decompose``."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

from ..errors import InputError
from .fitting import fit
from .options import MODEL, RIG, FitOptions, option, takes


@dataclasses.dataclass(kw_only=True)
class DecomposeOptions(FitOptions):
    """Arguments and options of ``ssdr decompose``."""

    smoothness: Annotated[float, option(MODEL, "Smoothness of the weights.", min=0.0)] = 0.0
    rig: Annotated[
        str | None,
        option(
            RIG,
            "Connect the bones by joints that may come apart (loose) or not (rigid), or keep the "
            "joints, parents and names of a file.",
            metavar="loose|rigid|[loose=]FILE",
        ),
    ] = None
    extra_bones: Annotated[
        str | None, option(RIG, "Bones to add, also below named ones.", metavar="N|NAME=N,...")
    ] = None
    keep_weights: Annotated[
        bool, option(RIG, "Keep the file's weights and rest pose.", "--keep-weights")
    ] = False


@takes
def decompose(options: DecomposeOptions) -> None:
    """Fit a rest pose, sparse skin weights and bones to an animated mesh.

    Several files of one mesh, or several clips of a file (--clip all), get one rest pose and one
    set of weights; each clip becomes an animation of its own.

    From glTF to glTF, the file gets a new skin and keeps the rest of what it holds.

    Ctrl-C stops and saves the best model so far; a second Ctrl-C ends at once.
    """
    import ssdr

    fit("decompose", ssdr.decompose, options, lambda: _arguments(options))


def _arguments(options: DecomposeOptions) -> dict[str, Any]:
    """Arguments of :func:`ssdr.decompose` from those options that only this command has."""
    import ssdr

    fitted = {"smoothness": options.smoothness}
    if options.rig in (None, "loose", "rigid"):
        for name in ("extra_bones", "keep_weights"):
            if getattr(options, name):
                option = "--" + name.replace("_", "-")
                raise InputError(option, "the file of a rig beside it (--rig FILE)", options.rig)
        if options.bones is None and options.start is None:
            raise InputError("--bones", "a number of bones, --rig FILE or --start MODEL", "none")
        return {"rig": options.rig, **fitted}
    file = options.rig.removeprefix("loose=")
    model = ssdr.load_skinning(file)
    rig = ssdr.Skeleton(
        model,
        joints="rigid" if file == options.rig else "loose",
        extra_bones=_extra_bones(options.extra_bones or "0"),
    )
    if not options.keep_weights:
        return {"rig": rig, **fitted}
    if options.start is not None:
        raise InputError("--start", "none beside --keep-weights", options.start)
    kept = ssdr.Start(rest=model.rest, indices=model.indices, weights=model.weights)
    return {"rig": rig, "start": kept, **fitted}


def _extra_bones(text: str) -> int | dict[str, int]:
    """Parse `--extra-bones`: a number of bones to add, or ``NAME=N,...``.

    The latter adds N bones below the rig's bone NAME.
    """
    try:
        if "=" not in text:
            return int(text)
        pairs = [part.rpartition("=") for part in text.split(",")]
        return {name.strip(): int(count) for name, _, count in pairs}
    except ValueError as error:
        expected = "a number, or NAME=N,... of bones of the rig"
        raise InputError("--extra-bones", expected, repr(text)) from error
