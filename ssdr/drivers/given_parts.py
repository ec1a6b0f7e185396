"""Check the parts of a model that a caller hands over: a start, and a skeleton."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import (
    BoneModel,
    check_floats,
    check_mask,
    check_skin,
    check_squarable,
    check_transforms,
    check_whole,
)
from ..errors import InputError, check_choice, is_whole
from ..hierarchy.tree import Tree
from ..joints.limb_matching import limb_distances
from ..search.given import Given
from ..sequence import MeshSequence
from ..skinning import Skinning
from ..solver.trajectories import Array
from ..start import JointKind, Skeleton, Start

__all__ = ["check_skeleton", "check_start", "extra_parents", "on_skeleton"]

Skin = tuple[NDArray[np.int32], Array]


def check_start(
    start: Any, shape: tuple[int, int, int, int], bone_model: BoneModel
) -> tuple[Given, Skinning | None]:
    """The parts to begin from, and the whole model where they are one; `shape` is (F, V, B, K)."""
    if start is None:
        return Given(), None
    if isinstance(start, Skinning):
        return _from_model(start, shape, bone_model), start
    if isinstance(start, Start):
        return _from_parts(start, shape, bone_model), None
    raise InputError("start", "None, a Skinning or a Start", type(start).__name__)


def _from_model(model: Skinning, shape: tuple[int, int, int, int], bone_model: BoneModel) -> Given:
    n_frames, n, bones, influences = shape
    if model.n_vertices != n:
        raise InputError("start", f"a model of {n} vertices, as the sequence has", model.n_vertices)
    indices, weights = _sorted_skin(model.indices, model.weights, (n, bones, influences), "start")
    transforms = None
    if model.n_frames == n_frames:
        transforms = check_transforms(model.transforms, n_frames, bone_model)
    tree = None
    if model.parents is not None:
        points = np.asarray(model.joint_positions, dtype=np.float64)
        gaps = model.joint_gaps().max()
        size = float(np.ptp(model.rest, axis=0).max())
        tree = Tree(model.parents.astype(np.int64), points, rigid=bool(gaps <= 1e-9 * size))
    return Given(
        rest=_check_rest(model.rest, n),
        indices=indices,
        weights=weights,
        transforms=transforms,
        free=True,
        tree=tree,
    )


def _from_parts(start: Start, shape: tuple[int, int, int, int], bone_model: BoneModel) -> Given:
    n_frames, n, bones, influences = shape
    indices, weights, transforms = start.indices, start.weights, start.transforms
    if (indices is None) != (weights is None):
        missing = "indices" if indices is None else "weights"
        raise InputError(
            f"start.{missing}", "an array beside the other of indices and weights", "None"
        )
    locked_vertices = check_mask(start.locked_vertices, "start.locked_vertices", n)
    if weights is not None:
        indices, weights = _sorted_skin(indices, weights, (n, bones, influences), "start.weights")
        if locked_vertices is None:
            locked_vertices = np.ones(n, dtype=bool)
    elif locked_vertices is not None:
        raise InputError("start.locked_vertices", "None without indices and weights", "a mask")
    locked_bones = None
    if transforms is not None:
        transforms = check_transforms(transforms, n_frames, bone_model)
        count = transforms.shape[1]
        if count > bones:
            raise InputError("start.transforms", f"at most {bones} bones, as asked for", count)
        if weights is not None and count != bones:
            raise InputError("start.transforms", f"{bones} bones beside given weights", count)
        locked_bones = check_mask(start.locked_bones, "start.locked_bones", count)
        if locked_bones is None:
            locked_bones = np.ones(count, dtype=bool)
    elif start.locked_bones is not None:
        raise InputError("start.locked_bones", "None without transforms", "a mask")
    return Given(
        rest=None if start.rest is None else _check_rest(start.rest, n),
        rest_frame=check_whole(start.rest_frame, "start.rest_frame", 0, n_frames - 1),
        indices=indices,
        weights=weights,
        transforms=transforms,
        locked_vertices=locked_vertices,
        locked_bones=locked_bones,
    )


def check_skeleton(rig: Skeleton) -> None:
    """Refuse a skeleton without hierarchy, and joints of an unknown kind."""
    model = rig.skinning
    if not isinstance(model, Skinning) or model.parents is None:
        came = "one without parents" if isinstance(model, Skinning) else type(model).__name__
        raise InputError("rig.skinning", "a Skinning with a hierarchy", came)
    check_choice(rig.joints, "rig.joints", JointKind)


def on_skeleton(
    rig: Skeleton, given: Given, sequences: list[MeshSequence], influences: int
) -> Given:
    """The given parts with the tree of a skeleton, its extra bones and its locked joints."""
    skeleton, extra = rig.skinning, extra_parents(rig)
    if extra and (rig.joints == "loose" or given.indices is not None):
        beside = "loose joints" if rig.joints == "loose" else "indices and weights"
        raise InputError("rig.extra_bones", f"0 beside {beside}", rig.extra_bones)
    if given.transforms is not None and not given.free:
        raise InputError("start.transforms", "None beside a skeleton", "an array")
    n, n_frames = sequences[0].n_vertices, sum(len(s) for s in sequences)
    points = np.asarray(skeleton.joint_positions, dtype=np.float64)
    tree = Tree(skeleton.parents.astype(np.int64), points, rigid=False)
    pose, nearest, skin = _frame(sequences, given.rest_frame), None, None
    if skeleton.n_vertices == n:
        pose = np.asarray(skeleton.rest, dtype=np.float64)
        skin = _largest(skeleton, influences)
    else:
        nearest = limb_distances(pose if given.rest is None else given.rest, tree).argmin(axis=1)
    return dataclasses.replace(
        given,
        tree=given.tree if given.free and given.tree is not None else tree,
        tree_pose=pose,
        nearest_bone=nearest,
        skeleton_skin=skin,
        extra_parents=extra,
        turns=_locked_turns(skeleton, rig.locked_joints, n_frames),
    )


def _check_rest(rest: Any, n_vertices: int) -> Array:
    points = check_floats(rest, "start.rest", (n_vertices, 3), copy=True)
    check_squarable(points, "start.rest")
    return np.asarray(points, dtype=np.float64)


def _sorted_skin(indices: Any, weights: Any, size: tuple[int, int, int], argument: str) -> Skin:
    """Indices and weights, the largest weights first, no bone twice at a vertex."""
    n, bones, influences = size
    indices, w = check_skin(indices, weights, n, bones)
    used = int((w > 0).sum(axis=1).max())
    if used > influences:
        raise InputError(argument, f"at most {influences} influences a vertex", used)
    w = w.astype(np.float64)
    order = np.argsort(-w, axis=1, kind="stable")
    w, indices = (np.take_along_axis(a, order, axis=1) for a in (w, indices))
    distinct = np.sort(np.where(w > 0, indices, -1 - np.arange(w.shape[1])), axis=1)
    twice = (distinct[:, 1:] == distinct[:, :-1]).any(axis=1)
    if twice.any():
        first = int(twice.argmax())
        raise InputError(argument, "no bone twice at a vertex", f"one twice at vertex {first}")
    return np.where(w > 0, indices, 0).astype(np.int32), w / w.sum(axis=1, keepdims=True)


def _largest(skeleton: Skinning, influences: int) -> Skin:
    """The largest influences of every vertex, largest first."""
    pruned = skeleton.prune(influences)
    weights = pruned.weights.astype(np.float64)
    return pruned.indices, weights / weights.sum(axis=1, keepdims=True)


def extra_parents(rig: Skeleton) -> tuple[int, ...]:
    """The parents of the bones that a skeleton gets more; −1: where the error is."""
    named = rig.extra_bones if isinstance(rig.extra_bones, Mapping) else {"": rig.extra_bones}
    parents: list[int] = []
    for name, count in named.items():
        if not is_whole(count) or count < 0:
            raise InputError("rig.extra_bones", "an integer >= 0, or some by name", repr(count))
        if isinstance(rig.extra_bones, Mapping):
            parents += [_single_joint(rig.skinning, name, "rig.extra_bones")] * int(count)
        else:
            parents += [-1] * int(count)
    return tuple(parents)


def _locked_turns(skeleton: Skinning, names: Any, n_frames: int) -> Array | None:
    """Local rotations (F, B, 3, 3) of the named joints, NaN for the others; None without names."""
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        raise InputError("rig.locked_joints", "names of joints of the skeleton", repr(names))
    if not names:
        return None
    if skeleton.n_frames not in (1, n_frames):
        expected = f"one pose of the skeleton, or {n_frames} as the sequence has"
        raise InputError("rig.locked_joints", expected, f"{skeleton.n_frames}")
    local = np.asarray(skeleton.local_transforms()[..., :3], dtype=np.float64)
    turns = np.full((n_frames, *local.shape[1:]), np.nan)
    for name in dict.fromkeys(names):
        joint = _single_joint(skeleton, name, "rig.locked_joints")
        if skeleton.parents[joint] < 0:
            raise InputError("rig.locked_joints", "joints that have a parent", f"{name!r}, a root")
        turns[:, joint] = local[:, joint]
    return turns


def _single_joint(skeleton: Skinning, name: Any, argument: str) -> int:
    """The one joint of a name."""
    names = skeleton.names()
    there = [k for k, known in enumerate(names) if known == name]
    if len(there) != 1:
        expected = f"names of single joints of the skeleton ({', '.join(names[:8])}, ...)"
        raise InputError(argument, expected, f"{name!r}, {len(there)} joints of that name")
    return there[0]


def _frame(sequences: list[MeshSequence], index: int) -> Array:
    """One frame of the shots, counted through all of them."""
    for sequence in sequences:
        if index < len(sequence):
            return np.asarray(sequence.vertices[index], dtype=np.float64)
        index -= len(sequence)
    raise AssertionError
