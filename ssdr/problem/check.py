"""Checks of the arguments of ``decompose`` and of functions that offer some of them."""

from __future__ import annotations

import dataclasses
from typing import Any

from ..checks import (
    check_bone_model,
    check_callback,
    check_frame_importance,
    check_importance,
    check_influences,
    check_rng,
    check_smoothness,
    check_whole,
)
from ..copies import told_apart
from ..errors import InputError, check_choice, check_flag, is_real, is_whole
from ..progress import Monitor
from ..sequence import as_sequences, labels_of, without_copies
from ..skinning import Skinning, skinning_in
from ..solver.model import Constraints
from ..solver.rest_surface import RestPose
from ..start import Skeleton, Start
from .check_start import (
    check_skeleton,
    check_start,
    extra_parents,
    refuse_weights,
    with_skeleton,
)
from .problem import Effort, Initial, Problem, RigKind


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
    check_choice(effort, "effort", Effort)
    check_choice(rest_pose, "rest_pose", RestPose)
    start = start if isinstance(start, Skeleton) else skinning_in(start)
    if not (start is None or isinstance(start, (Skinning, Start))):
        raise InputError("start", "None, a Skinning or a result, or a Start", type(start).__name__)
    if not (rig is None or isinstance(rig, Skeleton) or _is_kind(rig)):
        raise InputError("rig", "None, 'loose', 'rigid' or a Skeleton", repr(rig))
    by_default = bones is None and most_bones is not None
    bones = _count_bones(min(n, most_bones or n) if by_default else bones, n, rig, start)
    initial, constraints = check_start(start, (n_frames, n, bones, influences), bone_model)
    if rest_frame is not None:
        frame = check_whole(rest_frame, "rest_frame", 0, n_frames - 1)
        if initial.rest is not None:
            raise InputError("rest_frame", "None beside a start that has a rest pose", frame)
        initial = dataclasses.replace(initial, rest_frame=frame)
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
        normals=check_flag(normals, "normals"),
        vertex_importance=importance,
        weighted=weighted,
        frame_importance=frame_importance,
        rng=check_rng(rng),
        monitor=Monitor(check_callback(callback), time_limit=time_limit, checkpoint=checkpoint),
    )


def _is_kind(rig: Any) -> bool:
    return isinstance(rig, str) and rig in ("loose", "rigid")


def _count_bones(bones: Any, n_vertices: int, rig: Any, start: Any) -> int:
    """Check the number of bones and return it.

    It is that of the skeleton with its extra bones, or of the model to start from.  Without these
    it is `bones`.
    """
    known, what = None, "bones"
    if isinstance(rig, Skeleton):
        check_skeleton(rig)
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
    if constraints.bone_model != "rigid":
        raise InputError("bone_model", f"'rigid' {beside}", repr(constraints.bone_model))
    if kind == "loose" and not initial.keeps_tree:
        return
    if not (initial.keeps_tree or initial.is_model):
        refuse_weights(initial, beside)
    if smoothness > 0:
        raise InputError("smoothness", f"0 {beside}", smoothness)
