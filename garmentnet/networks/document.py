"""What a checkpoint says of garment and body, read without torch."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ssdr import Skinning
from ssdr.errors import FormatError
from ssdr.io.registry import check

from ..data.skeleton import Skeleton
from ..data.skin_weights import BodyBound
from ..data.subject import Subject

__all__ = ["BOUND", "FORMAT", "MESH", "VERSION", "read_subject"]

FORMAT, VERSION = "garmentnet checkpoint", 4
# Arrays of a mesh, and of what the body carries.
MESH = ("rest", "indices", "weights", "faces")
BOUND = tuple(f.name for f in dataclasses.fields(BodyBound))
# Bytes of the dense skinning matrix beyond which a file counts as hostile: 3 million vertices and
# 80 bones in float32.
_MAX_SKINNING = 4 << 30


def read_subject(
    arrays: dict[str, Any], documents: dict[str, Any]
) -> tuple[dict[str, Any], Subject]:
    """The checkpoint's document, and whom its networks were trained for.

    Parameters
    ----------
    arrays : dict of array
        All of the file.
    documents : dict

    Raises
    ------
    FormatError
        If it is no checkpoint, of another version, or contradicts itself.
    """
    d = documents["checkpoint"]
    check(isinstance(d, dict) and d.get("format") == FORMAT, "not a checkpoint of garmentnet")
    check(d.get("version") == VERSION, f"version {d.get('version')}, this reads {VERSION}")
    names = tuple(str(n) for n in d["joint_names"])
    skeleton = Skeleton(names, arrays["skeleton.parents"], arrays["skeleton.rest"])
    bones = len(arrays["network.0.low.code.centres"])
    subject = Subject(
        _skinning(arrays, "garment", bones, None),
        _skinning(arrays, "body", skeleton.n_joints, names),
        skeleton,
        float(d["fps"]),
        str(d["garment_id"]),
        _bound(arrays, skeleton.n_joints),
    )
    check(subject.body_id == d["body_id"], "the body is not the one that the file names")
    return d, subject


def _skinning(
    arrays: dict[str, Any], name: str, bones: int, names: tuple[str, ...] | None
) -> Skinning:
    rest, indices = arrays[f"{name}.rest"], arrays[f"{name}.indices"]
    if len(rest) * bones * 16 > _MAX_SKINNING:
        raise FormatError(f"{name}: {len(rest)} vertices and {bones} bones")
    return Skinning(
        rest,
        indices,
        arrays[f"{name}.weights"],
        np.tile(np.eye(3, 4), (1, bones, 1, 1)),
        faces=arrays[f"{name}.faces"],
        bone_names=names,
    )


def _bound(arrays: dict[str, Any], joints: int) -> BodyBound | None:
    if "bound.index" not in arrays:
        return None
    bound = BodyBound(**{k: arrays[f"bound.{k}"] for k in BOUND})
    count, vertices = len(bound.index), len(arrays["garment.rest"])
    fits = (
        0 < count <= vertices
        and bound.rest.shape == bound.smooth.shape == (count, 3)
        and bound.indices.shape == bound.weights.shape == (count, bound.weights.shape[1])
        and (np.diff(bound.index) > 0).all()
        and bound.index[0] >= 0
        and bound.index[-1] < vertices
        and bound.indices.min() >= 0
        and bound.indices.max() < joints
    )
    check(fits, "bound: vertices or joints that do not exist")
    return bound
