"""What ``--rig``, ``--start`` and the options beside them stand for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import InputError
from ..sequence import MeshSequence
from .options import FitOptions
from .reading import read_any


def rig_of(options: FitOptions) -> Any:
    """The argument `rig` of :func:`ssdr.decompose`.

    Raises
    ------
    InputError
        If an option is given that needs the file of a rig, or the file holds no tree of joints.
    """
    if options.rig in (None, "loose", "rigid"):
        for name in ("extra_bones", "lock", "keep_weights"):
            if getattr(options, name):
                option = "--" + name.replace("_", "-")
                raise InputError(option, "the file of a rig beside it (--rig FILE)", options.rig)
        return options.rig
    import ssdr

    file = options.rig.removeprefix("loose=")
    return ssdr.Skeleton(
        ssdr.load_skinning(file),
        joints="rigid" if file == options.rig else "loose",
        extra_bones=_extra_bones(options.extra_bones or "0"),
        locked_joints=[name.strip() for name in options.lock.split(",")] if options.lock else (),
    )


def start_of(options: FitOptions, rig: Any) -> Any:
    """The argument `start` of :func:`ssdr.decompose`.

    Parameters
    ----------
    options : FitOptions
    rig : Skeleton, str or None
        As :func:`rig_of` returns it.

    Raises
    ------
    InputError
        If ``--keep-weights`` is given beside it.
    """
    import ssdr

    text = options.start
    if options.keep_weights:
        if text is not None:
            raise InputError("--start", "none beside --keep-weights", text)
        kept = rig.skinning
        return ssdr.Start(rest=kept.rest, indices=kept.indices, weights=kept.weights)
    if text is None:
        return None
    if text.isdecimal() and not Path(text).exists():
        return ssdr.Start(rest_frame=int(text))
    thing = read_any(Path(text))
    return ssdr.Start(rest=thing.vertices[0]) if isinstance(thing, MeshSequence) else thing


def _extra_bones(text: str) -> int | dict[str, int]:
    """A number, or numbers by name."""
    try:
        if "=" not in text:
            return int(text)
        pairs = [part.rpartition("=") for part in text.split(",")]
        return {name.strip(): int(count) for name, _, count in pairs}
    except ValueError as error:
        expected = "a number, or NAME=N,... of bones of the rig"
        raise InputError("--extra-bones", expected, repr(text)) from error
