"""The command ``ssdr decompose``."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

from ..engines import EngineName
from ..errors import InputError
from .fitting import fit
from .options import FILES, MODEL, RIG, FitOptions, option, takes
from .presets import engine_of, finished, preset

_NOT_BESIDE_LEVELS = (
    *("bone_model", "rest_pose", "normals", "smoothness", "rig", "extra_bones", "lock"),
    *("keep_weights", "root_motion", "start", "time_limit", "checkpoint"),
)
_LEVELS = "several numbers of --bones (levels of detail)"


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
    lock: Annotated[
        str | None, option(RIG, "Joints that keep the file's rotations.", metavar="NAME,...")
    ] = None
    keep_weights: Annotated[
        bool, option(RIG, "Keep the file's weights and rest pose.", "--keep-weights")
    ] = False
    root_motion: Annotated[
        bool, option(RIG, "Move a root joint by ground track and heading.", "--root-motion")
    ] = False
    engine: Annotated[
        EngineName | None,
        option(FILES, "Engine whose limits are the defaults of other options.", "--for"),
    ] = None


@takes
def decompose(options: DecomposeOptions) -> None:
    """Fit a rest pose, sparse skin weights and bones to an animated mesh.

    Several files of one mesh, or several clips of a file (--clip all), get one rest pose and one
    set of weights; each clip becomes an animation of its own.

    From glTF to glTF and from USD to USD, the file gets a new skin and keeps the rest of
    what it holds.

    Ctrl-C stops and saves the best model so far; a second Ctrl-C ends at once.
    """
    import ssdr

    engine = engine_of(options.engine)
    said = {} if engine is None else {"for": preset(options, engine)}

    def solve(*shots: Any, **arguments: Any) -> Any:
        if not isinstance(options.bones, tuple):
            result = ssdr.decompose(*shots, **arguments)
        else:
            names = ("bones", "effort", "rng", "callback")
            same = {name: arguments[name] for name in names}
            result = ssdr.levels(*shots, influences=options.influences[0], **same)
            said["levels"] = _levels_text(result, shots[0])
        return finished(result, options, engine, options.root_motion, said)

    fit("decompose", solve, options, lambda: _arguments(options), said)


def _arguments(options: DecomposeOptions) -> dict[str, Any]:
    """Arguments of :func:`ssdr.decompose` from those options that only this command has.

    For levels of detail, the storage in `options.influences` is set to "float32".
    """
    import ssdr

    if isinstance(options.bones, tuple):
        _check_levels(options)
        options.influences = options.influences[0], "float32"  # the levels are solved with floats
        return {}
    fitted = {"smoothness": options.smoothness}
    if options.rig in (None, "loose", "rigid"):
        for name in ("extra_bones", "lock", "keep_weights"):
            if getattr(options, name):
                option = "--" + name.replace("_", "-")
                raise InputError(option, "the file of a rig beside it (--rig FILE)", options.rig)
        if options.bones is None and (options.start is None or options.start.isdecimal()):
            raise InputError("--bones", "a number of bones, --rig FILE or --start MODEL", "none")
        return {"rig": options.rig, **fitted}
    file = options.rig.removeprefix("loose=")
    model = ssdr.load_skinning(file)
    rig = ssdr.Skeleton(
        model,
        joints="rigid" if file == options.rig else "loose",
        extra_bones=_extra_bones(options.extra_bones or "0"),
        locked_joints=[name.strip() for name in options.lock.split(",")] if options.lock else (),
    )
    if not options.keep_weights:
        return {"rig": rig, **fitted}
    if options.start is not None:
        raise InputError("--start", "none beside --keep-weights", options.start)
    kept = ssdr.Start(rest=model.rest, indices=model.indices, weights=model.weights)
    return {"rig": rig, "start": kept, **fitted}


def _check_levels(options: DecomposeOptions) -> None:
    """Raise InputError for options that cannot be combined with levels of detail."""
    for field in dataclasses.fields(options):
        if field.name in _NOT_BESIDE_LEVELS and getattr(options, field.name) != field.default:
            flag = "--" + field.name.replace("_", "-")
            raise InputError(flag, f"none beside {_LEVELS}", getattr(options, field.name))
    for path in options.outputs:
        if path.suffix.lower() not in (".glb", ".gltf"):
            raise InputError("--output", f"glTF for {_LEVELS}", str(path))


def _levels_text(result: Any, shots: Any) -> str:
    """Text with the number of bones and the error of each level of detail."""
    listed = shots if isinstance(shots, list) else [shots]
    percent = 100 / max(shot.diagonal() for shot in listed)
    return "; ".join(
        f"{level.n_bones} bones: RMSE {error * percent:.3g} % of the diagonal, "
        f"{error / alone if alone else 1:.2f} times that of a model of its own"
        for level, error, alone in zip(result.levels, result.errors, result.alone, strict=True)
    )


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
