"""What the command line says of a rig that is handed over."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import InputError
from ..sequence import MeshSequence
from .reading import options_for, read_clips

__all__ = ["extra_bones_of", "rest_pose", "skeleton_parts"]


def extra_bones_of(text: str) -> int | dict[str, int]:
    """A number, or numbers by name."""
    expected = "a number, or NAME=N,... of bones of the skeleton"
    try:
        if "=" not in text:
            if int(text) < 0:
                raise ValueError("negative")
            return int(text)
        pairs = [part.rpartition("=") for part in text.split(",")]
        return {name.strip(): int(count) for name, _, count in pairs}
    except ValueError as error:
        raise InputError("--extra-bones", expected, repr(text)) from error


def skeleton_parts(
    path: Path | None, extra: int | dict[str, int], keep_weights: bool, lock: str | None
) -> dict[str, Any]:
    """The arguments of ``decompose`` that a rig gives."""
    if path is None:
        return {}
    import ssdr

    rig = ssdr.load_skinning(path)
    if rig.parents is None:
        raise InputError("--skeleton", "a file whose joints hang on each other", str(path))
    parts: dict[str, Any] = {"skeleton": rig}
    if extra:
        parts["extra_bones"] = extra
    if lock:
        parts["locked_joints"] = [name.strip() for name in lock.split(",")]
    if keep_weights:
        parts |= {"indices": rig.indices, "weights": rig.weights, "rest": rig.rest}
    return parts


def rest_pose(
    path: Path,
    shot: MeshSequence,
    read: list[str] | None,
    *,
    weld: bool,
    scale: float | None,
) -> Any:
    """The first frame ``(V, 3)`` of a file, of the mesh that a shot is of."""
    options = options_for([path], read, fps=None, weld=weld, scale=scale)
    posed = read_clips([path], None, options)[0]
    if posed.n_vertices != shot.n_vertices:
        expected = f"{shot.n_vertices} vertices, those of the animation"
        raise InputError("--rest", expected, f"{posed.n_vertices} in {path}")
    return posed.vertices[0]
