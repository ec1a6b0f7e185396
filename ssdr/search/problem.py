"""Parts of a model that a caller hands over: checked, then brought to the solver's space."""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import check_mask, check_rest, check_transforms, check_weights
from ..errors import InputError
from ..skinning import BoneModel
from ..solver.trajectories import Alignment, Array, Trajectories

__all__ = ["Given", "Parts", "check_parts", "fingerprint", "normalise"]


@dataclasses.dataclass(frozen=True, eq=False)
class Given:
    """What the caller handed over, in normalised space."""

    rest: Array | None = None
    transforms: Array | None = None
    joints: Any = None
    weights: Array | None = None
    rest_frame: int = 0


@dataclasses.dataclass(frozen=True, eq=False)
class Parts:
    """Fixed parts as the caller gave them, checked."""

    rest: Array | None
    joints: NDArray[np.int32] | None
    weights: Array | None
    transforms: Array | None
    locked_vertices: NDArray[np.bool_] | None
    locked_bones: NDArray[np.bool_] | None

    @property
    def kept_bones(self) -> NDArray[np.bool_] | None:
        """`locked_bones` up to the last that is locked; None where none is."""
        if self.locked_bones is None or not self.locked_bones.any():
            return None
        return self.locked_bones[: int(np.flatnonzero(self.locked_bones)[-1]) + 1]


def check_parts(
    n: int, n_frames: int, bones: int, influences: int, rest: Any, joints: Any, weights: Any,
    transforms: Any, locked_vertices: Any, locked_bones: Any, bone_model: BoneModel = "rigid",
) -> Parts:  # fmt: skip
    if (joints is None) != (weights is None):
        missing = "joints" if joints is None else "weights"
        raise InputError(missing, "an array beside the other of joints and weights", "None")
    rest = None if rest is None else check_rest(rest, n)
    vertex_mask = check_mask(locked_vertices, "locked_vertices", n)
    if weights is not None:
        joints, weights = check_weights(joints, weights, n)
        if joints.max() >= bones:
            raise InputError("joints", f"indices from 0 to {bones - 1}", int(joints.max()))
        used = int((weights > 0).sum(axis=1).max())
        if used > influences:
            raise InputError("weights", f"at most {influences} influences a vertex", used)
        order = np.argsort(-weights, axis=1, kind="stable")
        weights = np.ascontiguousarray(np.take_along_axis(weights, order, axis=1))
        joints = np.ascontiguousarray(np.take_along_axis(joints, order, axis=1))
        named = np.sort(np.where(weights > 0, joints, -1 - np.arange(joints.shape[1])), axis=1)
        twice = (named[:, 1:] == named[:, :-1]).any(axis=1)
        if twice.any():
            raise InputError(
                "joints", "no bone twice at a vertex", f"one twice at vertex {int(twice.argmax())}"
            )
        joints[weights == 0] = 0
        if vertex_mask is None:
            vertex_mask = np.ones(n, dtype=bool)
    elif vertex_mask is not None:
        raise InputError("locked_vertices", "None without joints and weights", "a mask")
    bone_mask = None
    if transforms is not None:
        transforms = check_transforms(transforms, n_frames, bone_model)
        count = transforms.shape[1]
        if count > bones:
            raise InputError("transforms", f"at most {bones} bones, as asked for", count)
        if weights is not None and count != bones:
            raise InputError("transforms", f"{bones} bones beside given weights", count)
        bone_mask = check_mask(locked_bones, "locked_bones", count)
        if bone_mask is None:
            bone_mask = np.ones(count, dtype=bool)
    elif locked_bones is not None:
        raise InputError("locked_bones", "None without transforms", "a mask")
    return Parts(rest, joints, weights, transforms, vertex_mask, bone_mask)


def normalise(data: Alignment, parts: Parts, rest_frame: int) -> Given:
    """Fixed parts in the solver's space."""
    origin = data.centre[:1] if parts.rest is None else parts.rest
    rest, transforms = data.from_world(origin, parts.transforms)
    return Given(
        rest=None if parts.rest is None else np.ascontiguousarray(rest), transforms=transforms,
        joints=parts.joints, weights=parts.weights, rest_frame=int(rest_frame),
    )  # fmt: skip


def fingerprint(data: Trajectories, parts: Parts, faces: NDArray[np.integer] | None = None) -> str:
    """Tells another input from the one that a state belongs to; `faces` where they count."""
    digest = hashlib.sha256()
    arrays: list[Any] = [data.x2, data.centre, data.importance, data.frame_scale, faces]
    arrays += [getattr(parts, f.name) for f in dataclasses.fields(parts)]
    for array in arrays:
        if array is not None:
            digest.update(str(np.shape(array)).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
