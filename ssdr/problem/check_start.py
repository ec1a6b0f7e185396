"""Checks of the parts of a model that a caller starts from: a start, and a skeleton."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..checks import (
    BoneModel,
    check_floats,
    check_skin,
    check_squarable,
    check_transforms,
)
from ..errors import InputError, check_choice, is_whole
from ..hierarchy.tree import Tree
from ..joints.limb_matching import limb_distances
from ..joints.placement import move_onto_joints
from ..sequence import MeshSequence
from ..skinning import Skinning
from ..solver.model import Constraints, Skin
from ..solver.trajectories import Array
from ..start import JointKind, Skeleton, Start
from .problem import Initial

# Largest joint gaps, relative to the mesh's size, that are rounding errors: of double precision,
# and of single precision or a file's keys.  Gaps between these two bounds are closed at once.
_EXACTLY, _NEARLY = 1e-12, 1e-4


def check_start(
    start: Skinning | Start | None, shape: tuple[int, int, int, int], bone_model: BoneModel
) -> tuple[Initial, Constraints]:
    """Check a start; return the parts of a model that it gives, and which of them are kept.

    `shape` is (F, V, B, K).
    """
    if isinstance(start, Start):
        return _from_parts(start, shape, bone_model)
    constraints = Constraints(bone_model=bone_model)
    return Initial() if start is None else _from_model(start, shape, bone_model), constraints


def _from_model(
    model: Skinning, shape: tuple[int, int, int, int], bone_model: BoneModel
) -> Initial:
    n_frames, n, bones, influences = shape
    if model.n_vertices != n:
        raise InputError("start", f"a model of {n} vertices, as the sequence has", model.n_vertices)
    if model.n_bones != bones:
        raise InputError("start", f"a model of {bones} bones, as the rig has", model.n_bones)
    skin = _sorted_skin(model.indices, model.weights, (n, bones, influences))
    transforms = None
    if model.n_frames == n_frames:
        transforms = check_transforms(model.transforms, n_frames, bone_model, "start.")
    tree = None
    if model.parents is not None:
        points = np.asarray(model.joint_positions, dtype=np.float64)
        gap = model.joint_gaps().max() / float(np.ptp(model.rest, axis=0).max() or 1.0)
        tree = Tree(model.parents.astype(np.int64), points, rigid=bool(gap <= _NEARLY))
        if transforms is not None and _EXACTLY < gap <= _NEARLY:
            move_onto_joints(transforms, tree)
    return Initial(
        rest=_check_rest(model.rest, n),
        skin=skin,
        transforms=transforms,
        is_model=True,
        tree=tree,
    )


def _from_parts(
    start: Start, shape: tuple[int, int, int, int], bone_model: BoneModel
) -> tuple[Initial, Constraints]:
    _, n, bones, influences = shape
    indices, weights, skin = start.indices, start.weights, None
    if (indices is None) != (weights is None):
        missing, other = ("weights", "indices") if weights is None else ("indices", "weights")
        dense = " (Skinning.from_dense has both of dense weights)" if weights is not None else ""
        raise InputError(f"start.{missing}", f"an array beside start.{other}{dense}", "None")
    constraints = Constraints(rest=start.rest is not None, bone_model=bone_model)
    if weights is not None:
        skin = _sorted_skin(indices, weights, (n, bones, influences))
        constraints = constraints.with_weights(n)
    rest = None if start.rest is None else _check_rest(start.rest, n)
    return Initial(rest=rest, skin=skin), constraints


def refuse_weights(initial: Initial, beside: str) -> None:
    """Raise InputError if weights to keep were given."""
    if initial.skin is not None:
        raise InputError("start.weights", f"None {beside}", "an array")


def check_skeleton(rig: Skeleton) -> None:
    """Raise InputError for a skeleton without a hierarchy, or for an unknown kind of joints."""
    model = rig.skinning
    if not isinstance(model, Skinning) or model.parents is None:
        came = "one without parents" if isinstance(model, Skinning) else type(model).__name__
        raise InputError("rig.skinning", "a Skinning with a hierarchy", came)
    check_choice(rig.joints, "rig.joints", JointKind)


def with_skeleton(
    rig: Skeleton,
    initial: Initial,
    constraints: Constraints,
    sequences: list[MeshSequence],
    influences: int,
    start: Skinning | Start | None,
) -> tuple[Initial, Constraints]:
    """Copies of the initial and kept parts with tree, extra bones and joints of a skeleton."""
    n = sequences[0].n_vertices
    skeleton, extra = rig.skinning, extra_parents(rig, n)
    if extra and rig.joints == "loose":
        raise InputError("rig.extra_bones", "0 beside loose joints", rig.extra_bones)
    constraints = dataclasses.replace(constraints, joints=constraints.rest)
    if isinstance(start, Skinning):
        tree = _same_tree(initial, skeleton)
        return dataclasses.replace(initial, tree=tree, keeps_tree=True), constraints
    if extra and initial.skin is not None:
        expected = "0 beside start.indices and start.weights"
        raise InputError("rig.extra_bones", expected, rig.extra_bones)
    points = np.asarray(skeleton.joint_positions, dtype=np.float64)
    tree = Tree(skeleton.parents.astype(np.int64), points, rigid=False)
    pose, nearest, skin = _frame(sequences, initial.rest_frame or 0), None, None
    if skeleton.n_vertices == n:
        pose = np.asarray(skeleton.rest, dtype=np.float64)
        skin = _largest(skeleton, influences)
    else:
        nearest = limb_distances(pose if initial.rest is None else initial.rest, tree).argmin(
            axis=1
        )
    return dataclasses.replace(
        initial,
        tree=tree,
        keeps_tree=True,
        tree_pose=pose,
        nearest_bone=nearest,
        skeleton_skin=skin,
        extra_parents=extra,
    ), constraints


def _same_tree(initial: Initial, skeleton: Skinning) -> Tree:
    """Check that the model to start from has the parents of the skeleton, and return its tree."""
    tree, known = initial.tree, skeleton.n_bones
    if tree is None or not np.array_equal(tree.parents[:known], skeleton.parents):
        raise InputError("start", "a model whose bones hang as those of rig.skinning", "others")
    return tree


def _check_rest(rest: Any, n_vertices: int) -> Array:
    points = check_floats(rest, "start.rest", (n_vertices, 3), copy=True)
    check_squarable(points, "start.rest")
    return np.asarray(points, dtype=np.float64)


def _sorted_skin(indices: Any, weights: Any, size: tuple[int, int, int]) -> Skin:
    """Check indices and weights; return them with the largest weight of each vertex first.

    `size` is (V, B, K).  A bone that occurs twice at a vertex is an error.
    """
    n, bones, influences = size
    indices, w = check_skin(indices, weights, n, bones, "start.")
    used = int((w > 0).sum(axis=1).max())
    if used > influences:
        wanted = f"at most {influences} influences a vertex (Skinning.prune({influences}) has them)"
        raise InputError("start.weights", wanted, used)
    w = w.astype(np.float64)
    order = np.argsort(-w, axis=1, kind="stable")
    w, indices = (np.take_along_axis(a, order, axis=1) for a in (w, indices))
    distinct = np.sort(np.where(w > 0, indices, -1 - np.arange(w.shape[1])), axis=1)
    twice = (distinct[:, 1:] == distinct[:, :-1]).any(axis=1)
    if twice.any():
        first = int(twice.argmax())
        came = f"one twice at vertex {first}"
        wanted = "no bone twice at a vertex (from_dense of dense_weights() adds them up)"
        raise InputError("start.indices", wanted, came)
    return Skin(np.where(w > 0, indices, 0).astype(np.int32), w / w.sum(axis=1, keepdims=True))


def _largest(skeleton: Skinning, influences: int) -> Skin:
    """Indices and weights of the `influences` largest influences of each vertex, largest first."""
    pruned = skeleton.prune(influences)
    weights = pruned.weights.astype(np.float64)
    return Skin(pruned.indices, weights / weights.sum(axis=1, keepdims=True))


def extra_parents(rig: Skeleton, n_vertices: int) -> tuple[int, ...]:
    """Parent of each bone to add to a skeleton; −1 if the bone goes where the error is largest."""
    named = rig.extra_bones if isinstance(rig.extra_bones, Mapping) else {"": rig.extra_bones}
    parents: list[int] = []
    for name, count in named.items():
        if not is_whole(count) or count < 0:
            raise InputError("rig.extra_bones", "an integer >= 0, or some by name", repr(count))
        if count + len(parents) + rig.skinning.n_bones > n_vertices:
            expected = f"no more bones in all than the {n_vertices} vertices"
            raise InputError("rig.extra_bones", expected, repr(rig.extra_bones))
        if isinstance(rig.extra_bones, Mapping):
            parents += [_single_joint(rig.skinning, name, "rig.extra_bones")] * int(count)
        else:
            parents += [-1] * int(count)
    return tuple(parents)


def _single_joint(skeleton: Skinning, name: Any, argument: str) -> int:
    """Index of the joint called `name`; raises InputError unless exactly one has that name."""
    names = skeleton.names()
    found = [k for k, known in enumerate(names) if known == name]
    if len(found) != 1:
        expected = f"names of single joints of the skeleton ({', '.join(names[:8])}, ...)"
        raise InputError(argument, expected, f"{name!r}, {len(found)} joints of that name")
    return found[0]


def _frame(sequences: list[MeshSequence], index: int) -> Array:
    """Positions (V, 3) of frame `index`, counted over the frames of all shots."""
    for sequence in sequences:
        if index < len(sequence):
            return np.asarray(sequence.vertices[index], dtype=np.float64)
        index -= len(sequence)
    raise AssertionError
