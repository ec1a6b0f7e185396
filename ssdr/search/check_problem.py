"""Checks of the arguments of ``decompose`` and of functions that offer some of them."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..common.checks import (
    BoneModel,
    check_bone_model,
    check_callback,
    check_floats,
    check_frame_importance,
    check_importance,
    check_influences,
    check_rng,
    check_skin,
    check_smoothness,
    check_squarable,
    check_transforms,
    check_whole,
    parse_normals,
)
from ..common.errors import InputError, SsdrWarning, check_choice, is_real, is_whole
from ..mesh.sequence import MeshSequence, as_sequences, labels_of, without_copies
from ..mesh.surface import told_apart
from ..model.skinning import Skinning, skinning_in
from ..model.start import JointKind, Kept, Skeleton
from ..model.transforms import rest_diagonal
from ..model.tree import Tree
from ..solver.model import Constraints, Skin
from ..solver.rest_surface import RestPose
from ..solver.trajectories import Array
from .problem import Effort, Initial, Problem, RigKind
from .progress import Monitor
from .trees.limb_matching import limb_distances
from .trees.placement import move_onto_joints


def check_problem(
    sequence: Any,
    faces: Any,
    *,
    bones: Any,
    influences: Any,
    effort: Any,
    bone_model: Any = "rigid",
    rig: Any = None,
    start: Any = None,
    vertex_importance: Any = None,
    frame_importance: Any = None,
    smoothness: Any = 0.0,
    rest_pose: Any = "surface",
    rest_frame: Any = None,
    normals: Any = True,
    rng: Any,
    time_limit: Any = None,
    checkpoint: Any = None,
    callback: Any = None,
    most_bones: int | None = None,
) -> Problem:
    """Check the arguments of ``decompose``, or of a function that offers some of them.

    If `most_bones` is given, `bones` may be None even without a model.  The number of bones is then
    `most_bones`, or the number of vertices that differ if that is smaller.

    Raises
    ------
    InputError
        If an argument is not usable, before anything is computed.
    """
    sequences = as_sequences(sequence, faces)
    n, n_frames = sequences[0].n_vertices, sum(len(s) for s in sequences)
    influences = check_influences(influences)
    bone_model = check_bone_model(bone_model)
    if isinstance(rig, Skeleton):
        check_skeleton(rig)
        bone_model = rig.skinning.bone_model if rig.joints == "kept" else bone_model
    check_choice(effort, "effort", Effort)
    check_choice(rest_pose, "rest_pose", RestPose)
    start = start if isinstance(start, Skeleton) else skinning_in(start)
    if not (start is None or isinstance(start, (Skinning, Kept))):
        raise InputError("start", "None, a Skinning or a result, or a Kept", type(start).__name__)
    kinds = isinstance(rig, str) and rig in ("loose", "rigid")
    if not (rig is None or isinstance(rig, Skeleton) or kinds):
        raise InputError("rig", "None, 'loose', 'rigid' or a Skeleton", repr(rig))
    by_default = bones is None and most_bones is not None
    bones = _count_bones(min(n, most_bones or n) if by_default else bones, n, rig, start)
    initial, constraints = Initial(), Constraints(bone_model=bone_model)
    shape = n_frames, n, bones, influences
    if isinstance(start, Kept):
        initial, constraints = _from_parts(start, shape, bone_model)
    elif start is not None:
        initial = _from_model(start, shape, bone_model)
    if rest_frame is not None:
        frame = check_whole(rest_frame, "rest_frame", 0, n_frames - 1)
        if initial.rest is not None:
            raise InputError("rest_frame", "None beside a start that has a rest pose", frame)
        initial = dataclasses.replace(initial, rest_frame=frame)
    for name, model in (("rig", getattr(rig, "skinning", None)), ("start", start)):
        if isinstance(model, Skinning):
            _compare_sizes(name, model, sequences)
    names: tuple[str, ...] = ()
    kind: RigKind = "none"
    if isinstance(rig, Skeleton):
        initial, constraints = with_skeleton(
            rig, initial, constraints, sequences, influences, start
        )
        kind, names = rig.joints, rig.skinning.names()
    elif rig is not None:
        kind = rig
    smoothness = check_smoothness(smoothness, sequences[0].faces)
    _check_rig(kind, initial, constraints, smoothness)
    if time_limit is not None and not (is_real(time_limit, finite=False) and time_limit > 0):
        raise InputError("time_limit", "a number of seconds > 0 or None", repr(time_limit))
    frame_importance = check_frame_importance(frame_importance, n_frames)
    importance = check_importance(vertex_importance, "vertex_importance", n)
    weighted = importance is not None or frame_importance is not None
    inputs, rows = sequences, None
    kept = () if initial.is_model else (initial.rest, *(initial.skin or ()))
    label = told_apart(labels_of(inputs), *kept)
    differ = int(label.max()) + 1
    if by_default:
        bones = min(bones, differ)
    if bones <= differ < n:
        sequences, importance, firsts, rows = without_copies(inputs, label, importance)
        initial, constraints = initial.of_vertices(firsts), constraints.select_vertices(firsts)
    near_skin = kind == "rigid" and not isinstance(rig, Skeleton)
    return Problem(
        sequences=sequences,
        inputs=inputs,
        rows=rows,
        bones=bones,
        influences=influences,
        effort=effort,
        rig=kind,
        names=names,
        constraints=dataclasses.replace(constraints, near_skin=near_skin),
        initial=initial,
        start=start if isinstance(start, Skinning) else None,
        smoothness=smoothness,
        rest_pose=rest_pose,
        normals=parse_normals(normals, lambda: max(s.diagonal() for s in inputs)),
        vertex_importance=importance,
        weighted=weighted,
        frame_importance=frame_importance,
        rng=check_rng(rng),
        monitor=Monitor(check_callback(callback), time_limit=time_limit, checkpoint=checkpoint),
    )


def _compare_sizes(name: str, model: Skinning, sequences: list[MeshSequence]) -> None:
    """Warn if a model is so much larger or smaller than the mesh that its unit may be another."""
    same = model.n_vertices == sequences[0].n_vertices or model.joint_positions is None
    points = model.rest if same else model.joint_positions
    own, mesh = rest_diagonal(points), rest_diagonal(_frame(sequences, 0))
    if min(own, mesh) > 0 and not 1 / _ALIKE < mesh / own < _ALIKE:
        text = (
            f"the {name} is {own:.4g} across, the mesh {mesh:.4g}, {mesh / own:.4g} times as "
            "much: if their units differ, state that of the mesh (load(..., units=), --units)"
        )
        warnings.warn(text, SsdrWarning, stacklevel=5)


def _count_bones(bones: Any, n_vertices: int, rig: Any, start: Any) -> int:
    """Check the number of bones and return it.

    It is that of the skeleton with its extra bones, or of the model to start from.  Without these
    it is `bones`.
    """
    known, what = None, "bones"
    if isinstance(rig, Skeleton):
        known, what = rig.skinning.n_bones + len(extra_parents(rig, n_vertices)), "rig"
    elif isinstance(start, Skinning):
        known, what = start.n_bones, "start"
    if bones is None and known is None:
        raise InputError("bones", f"an integer from 1 to {n_vertices}", "None")
    if known is not None and bones is not None and not (is_whole(bones) and bones == known):
        raise InputError("bones", f"{known}, as the {what} has, or None", repr(bones))
    if known is None:
        return check_whole(bones, "bones", 1, n_vertices, " (the number of vertices)")
    if known > n_vertices:
        raise InputError(what, f"at most {n_vertices} bones, as there are vertices", known)
    return known


def _check_rig(
    kind: RigKind, initial: Initial, constraints: Constraints, smoothness: float
) -> None:
    """Raise InputError for arguments that cannot be combined with bones attached at joints."""
    if kind == "none":
        return
    beside = "beside a Skeleton" if initial.keeps_tree else f"beside rig={kind!r}"
    if constraints.bone_model != "rigid" and kind != "kept":
        raise InputError("bone_model", f"'rigid' {beside}", repr(constraints.bone_model))
    if kind == "loose" and not initial.keeps_tree:
        return
    if not (initial.keeps_tree or initial.is_model):
        refuse_weights(initial, beside)
    if smoothness > 0:
        raise InputError("smoothness", f"0 {beside}", smoothness)


Shape = tuple[int, int, int, int]  # F, V, B, K
_ALIKE = 8.0  # largest ratio of the sizes of a model and a mesh in one unit
# Largest joint gaps, relative to the mesh's size, that are rounding errors: of double precision,
# and of single precision or a file's keys.  Gaps between these two bounds are closed at once.
_EXACTLY, _NEARLY = 1e-12, 1e-4


def _from_model(model: Skinning, shape: Shape, bone_model: BoneModel) -> Initial:
    """Check a model to start from, and return its parts."""
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
        rest=_check_rest(model.rest, n), skin=skin, transforms=transforms, is_model=True, tree=tree
    )


def _from_parts(start: Kept, shape: Shape, bone_model: BoneModel) -> tuple[Initial, Constraints]:
    """Check parts to keep; return them, and that they are kept."""
    _, n, bones, influences = shape
    indices, weights, skin = start.indices, start.weights, None
    if (indices is None) != (weights is None):
        missing, other = ("weights", "indices") if weights is None else ("indices", "weights")
        dense = " (Skinning.from_dense has both of dense weights)" if weights is not None else ""
        raise InputError(f"start.{missing}", f"an array beside start.{other}{dense}", "None")
    constraints = Constraints(lock_rest=start.rest is not None, bone_model=bone_model)
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
        raise InputError("rig.skinning", "a model whose bones have parents", came)
    check_choice(rig.joints, "rig.joints", JointKind)


def with_skeleton(
    rig: Skeleton,
    initial: Initial,
    constraints: Constraints,
    sequences: list[MeshSequence],
    influences: int,
    start: Skinning | Kept | None,
) -> tuple[Initial, Constraints]:
    """Copies of the initial and kept parts with tree, extra bones and joints of a skeleton."""
    n = sequences[0].n_vertices
    skeleton, extra = rig.skinning, extra_parents(rig, n)
    if extra and rig.joints != "rigid":
        raise InputError("rig.extra_bones", f"0 beside {rig.joints} joints", rig.extra_bones)
    constraints = dataclasses.replace(constraints, lock_joints=constraints.lock_rest)
    if isinstance(start, Skinning):
        if rig.joints == "kept":
            raise InputError("start", "None or a Kept beside joints that are kept", "a Skinning")
        known, tree = skeleton.n_bones, initial.tree
        if tree is None or not np.array_equal(tree.parents[:known], skeleton.parents):
            raise InputError("start", "a model whose bones hang as those of rig.skinning", "others")
        return dataclasses.replace(initial, keeps_tree=True), constraints
    if extra and initial.skin is not None:
        expected = "0 beside start.indices and start.weights"
        raise InputError("rig.extra_bones", expected, rig.extra_bones)
    points, moves = np.asarray(skeleton.joint_positions, dtype=np.float64), None
    pose: Array | None = _frame(sequences, initial.rest_frame or 0)
    nearest, skin = None, None
    if rig.joints == "kept":
        count = sum(map(len, sequences))
        if skeleton.n_frames != count:
            wanted = f"joints that move in the {count} frames of the sequence"
            raise InputError("rig.skinning", wanted, f"{skeleton.n_frames} frames")
        kind = constraints.bone_model
        moves = check_transforms(skeleton.transforms, count, kind, "rig.skinning.")
    tree = Tree(skeleton.parents.astype(np.int64), points, rigid=False)
    if skeleton.n_vertices == n:
        pose = np.asarray(skeleton.rest, dtype=np.float64)
        skin = _largest(skeleton, influences)
    elif moves is not None:
        pose = None  # that in which the joints rest, which is not known
    else:
        at = pose if initial.rest is None else initial.rest
        assert at is not None
        nearest = limb_distances(at, tree).argmin(axis=1)
    return dataclasses.replace(
        initial,
        tree=tree,
        transforms=moves,
        keeps_tree=True,
        tree_pose=pose,
        nearest_bone=nearest,
        skeleton_skin=skin,
        extra_parents=extra,
    ), constraints


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
        by_name = isinstance(rig.extra_bones, Mapping)
        parents += [_single_joint(rig.skinning, name) if by_name else -1] * int(count)
    return tuple(parents)


def _single_joint(skeleton: Skinning, name: Any) -> int:
    """Index of the joint called `name`; raises InputError unless exactly one has that name."""
    names = skeleton.names()
    found = [k for k, known in enumerate(names) if known == name]
    if len(found) != 1:
        expected = f"names of single joints of the skeleton ({', '.join(names[:8])}, ...)"
        came = f"{name!r}, {len(found)} joints of that name"
        raise InputError("rig.extra_bones", expected, came)
    return found[0]


def _frame(sequences: list[MeshSequence], index: int) -> Array:
    """Positions (V, 3) of frame `index`, counted over the frames of all shots."""
    for sequence in sequences:
        if index < len(sequence):
            return np.asarray(sequence.vertices[index], dtype=np.float64)
        index -= len(sequence)
    raise AssertionError
