"""Up axes of files and models, and rotations from one to the other."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..sequence import MeshSequence
from ..skinning import Skinning
from ..surface import Surface

Up = Literal["y", "z"]

# a quarter turn about x, which carries z up to y up
_Y_FROM_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def check_up(up: object, *, optional: bool = False) -> None:
    """Raise an InputError unless `up` is "y" or "z" (or None, if `optional`)."""
    if up not in ("y", "z") and not (optional and up is None):
        raise InputError("up", '"y" or "z"' + (" or None" if optional else ""), repr(up))


def turn_up(values: NDArray[Any], source: Up, target: Up) -> NDArray[Any]:
    """Vectors ``(..., 3)``, rotated so that `target` is the up axis in place of `source`."""
    if source == target:
        return values
    turn = _Y_FROM_Z if source == "z" else _Y_FROM_Z.T
    return np.asarray(values @ turn.T.astype(values.dtype))


def turn_sequence_up(sequence: MeshSequence, source: Up, target: Up) -> MeshSequence:
    """Sequence rotated so that `target` is the up axis in place of `source`."""
    if source == target:
        return sequence
    return dataclasses.replace(
        sequence,
        vertices=turn_up(sequence.vertices, source, target),
        surface=_turn_surface_up(sequence.surface, source, target),
    )


def _turn_surface_up(surface: Surface | None, source: Up, target: Up) -> Surface | None:
    if surface is None or surface.normals is None:
        return surface
    return dataclasses.replace(surface, normals=turn_up(surface.normals, source, target))


def turn_skinning_up(skinning: Skinning, source: Up, target: Up) -> Skinning:
    """Skinning rotated so that `target` is the up axis in place of `source`.

    The rotation Q takes positions x to Q x, and bone transforms M to Q M Q⁻¹.
    """
    if source == target:
        return skinning
    turn = _Y_FROM_Z if source == "z" else _Y_FROM_Z.T
    m = np.asarray(skinning.transforms, dtype=np.float64)
    linear = turn @ m[..., :3] @ turn.T
    moved = np.concatenate([linear, (m[..., 3] @ turn.T)[..., None]], axis=-1)
    at = skinning.joint_positions
    return dataclasses.replace(
        skinning,
        rest=turn_up(skinning.rest, source, target),
        joint_positions=None if at is None else turn_up(at, source, target),
        transforms=moved.astype(skinning.transforms.dtype),
        surface=_turn_surface_up(skinning.surface, source, target),
    )
