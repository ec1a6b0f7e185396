"""Conversion of the best model to a skinning in the input's space, with its true error."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from ..mesh.clips import names_of
from ..mesh.normals import corner_normals
from ..metrics.normal_angles import NormalErrors, errors_of_model
from ..model import frame_error as frames_error
from ..model.drawn_normals import with_fitted_normals
from ..model.frame_error import motion_rms
from ..model.skinning import Skinning
from ..solver.alignment import Alignment
from ..solver.alternation import normalise_gauge
from ..solver.model import Model
from ..solver.warmup import compile_kernels
from .problem import Problem
from .progress import Record
from .result import Decomposition
from .trees.placement import refit_joints, spanning_tree

# Largest ratio of the true error to that of the objective at which records are scaled to the true
# error.  A larger ratio means that the error is of vertices with almost no importance.
_MOST_RATIO = 10.0

# iteration, seconds, squared error and phase of an accepted model
Step = tuple[int, float, float, str]

Result = TypeVar("Result", bound=Decomposition)


def skinning_of(
    problem: Problem,
    alignment: Alignment,
    model: Model,
) -> Skinning:
    """Convert a model to a skinning in the input's space, with the faces and names of the input.

    The skinning's normals are those of the rest pose, if the input has any: :func:`with_normals`
    fits better ones.
    """
    skin = dataclasses.replace(model, transforms=model.transforms[:0])
    padded = skin.with_influences(problem.influences)
    if problem.constraints.bone_model != "rigid":
        model = model.copy()
        importance = problem.vertex_importance
        equal = np.ones(len(model.rest))
        normalise_gauge(model, equal if importance is None else importance, problem.constraints)
    rest, transforms = alignment.to_world(model.rest, model.transforms)
    rest, indices, weights = problem.for_inputs(rest, padded.indices, padded.weights)
    first = problem.inputs[0]
    surface = first.surface
    if surface is not None and surface.normals is not None:
        normals = corner_normals(rest, first.faces, surface)
        surface = dataclasses.replace(surface, normals=normals)
    skinning = Skinning(
        rest,
        indices,
        weights,
        transforms,
        faces=first.faces,
        bone_model=problem.constraints.bone_model,
        surface=surface,
        vertex_map=first.vertex_map,
        **names_of(problem.sequences),
    )
    return skinning if problem.rig == "none" else _with_tree(skinning, problem, model, alignment)


def outcome_of(
    problem: Problem,
    alignment: Alignment,
    model: Model,
    steps: list[Step],
    *,
    reason: str,
    removable: int,
) -> Decomposition:
    """Outcome of a run: the model in the input's space, its true error, and the history.

    If the call was given a start model that it may return unchanged (see `_is_an_answer`), and the
    error of that model is less, the start model is returned instead. `steps` hold squared errors in
    the solver's space; `removable` is the number of bones that could each be removed at no loss.
    """
    count = problem.n_frames * problem.n_vertices

    def rmse_of(s: Skinning) -> float:
        parts = (s.rest, s.indices, s.weights, s.transforms)
        return frames_error.rmse(problem.inputs, *parts, executor=problem.executor)

    skinning = skinning_of(problem, alignment, model)
    rmse = rmse_of(skinning)
    if problem.start is not None and _is_an_answer(problem, problem.start):
        start = _start_as_result(problem, skinning)
        before = rmse_of(start)
        if before < rmse:
            skinning, rmse = start, before
    skinning, normals = with_normals(problem, skinning)
    values = np.array([value for _, _, value, _ in steps])
    hint = f"{removable} of {problem.bones} bones could each go at no loss: fewer bones would do"
    return Decomposition(
        skinning=skinning,
        rmse=rmse,
        stop_reason=reason,
        history=_history(steps, alignment.scale * np.sqrt(np.maximum(values, 0.0) / count), rmse),
        offsets=problem.offsets,
        normals=normals,
        motion=motion_rms(problem.inputs, executor=problem.executor),
        copies=problem.copies,
        warnings=(hint,) if removable else (),
    )


def with_normals(problem: Problem, skinning: Skinning) -> tuple[Skinning, NormalErrors | None]:
    """A copy of the skinning with fitted rest normals, and the errors of its normals.

    The errors are None if no normal of the input is known.
    """
    sequences, executor = problem.inputs, problem.executor
    fitted = with_fitted_normals(sequences, skinning, executor=executor)
    return fitted, errors_of_model(sequences, fitted, executor=executor)


def finished(problem: Problem, solve: Callable[[Problem], Result]) -> Result:
    """Make the whole run: compile, solve, write the last checkpoint."""
    seconds = compile_kernels()
    problem.monitor.leave_out(seconds)
    result = dataclasses.replace(solve(problem), compile_seconds=seconds)
    problem.monitor.offer(lambda: result.skinning, now=True)
    return result


def _is_an_answer(problem: Problem, start: Skinning) -> bool:
    """Whether the call may return its start model unchanged.

    It may if the model has all frames of the problem, the call has neither importances nor
    smoothness and, for a rigid rig, the given tree is rigid.
    """
    plain = not problem.weighted
    rigid = problem.rig != "rigid" or (
        problem.initial.tree is not None and problem.initial.tree.rigid
    )
    frames = start.n_frames == problem.n_frames
    return plain and rigid and frames and problem.smoothness == 0


def _start_as_result(problem: Problem, found: Skinning) -> Skinning:
    """Skinning of the model that a call starts from, with the names and clips of `found`."""
    initial, k = problem.initial, problem.influences
    assert problem.start is not None
    start = problem.start.prune(k)
    indices, weights = (
        np.pad(a, [(0, 0), (0, k - a.shape[1])])
        for a in (start.indices, np.asarray(start.weights, dtype=np.float64))
    )
    parts: dict[str, Any] = {"rest": start.rest, "transforms": initial.transforms}
    if found.parents is not None and initial.tree is not None:
        parts |= {"parents": initial.tree.parents, "joint_positions": initial.tree.points}
    return dataclasses.replace(found, indices=indices, weights=weights, **parts)


def _with_tree(
    skinning: Skinning, problem: Problem, model: Model, alignment: Alignment
) -> Skinning:
    """A copy of the skinning with parents, joints and names of its bones.

    They are those of the given skeleton if there is one; otherwise they are found from the motion.
    """
    tree, n_bones = problem.initial.tree, skinning.n_bones
    if problem.rig == "loose" and tree is not None:
        tree = refit_joints(skinning.transforms, tree)
        joints = tree.points
    else:
        tree = model.hierarchy if problem.rig == "rigid" else spanning_tree(model, by_gap=True)
        joints = alignment.points_to_world(tree.points)
    joints[tree.roots] = skinning.centroids()[tree.roots]
    digits = len(str(n_bones - 1))
    numbered = [f"joint_{k:0{digits}d}" for k in range(len(problem.names), n_bones)]
    return dataclasses.replace(
        skinning,
        parents=tree.parents,
        joint_positions=joints,
        bone_names=(*problem.names, *numbered),
    )


def _history(steps: list[Step], errors: np.ndarray, rmse: float) -> tuple[Record, ...]:
    """Records of the steps, with errors that never rise and end at `rmse`, the error on all frames.

    The given `errors` belong to compressed trajectories and weighted frames.  All are multiplied by
    the factor that makes the last one equal to `rmse`, unless the last is 0 or far too small.
    """
    last = errors[-1]
    proportional = last > 0 and rmse < _MOST_RATIO * last
    errors = errors * (rmse / last) if proportional else errors
    # with a penalty on joints, a better model may have a slightly larger error
    errors = np.maximum(np.minimum.accumulate(errors), rmse)
    errors[-1] = rmse
    return tuple(
        Record(iteration=iteration, elapsed=elapsed, rmse=float(error), phase=phase)
        for (iteration, elapsed, _, phase), error in zip(steps, errors, strict=True)
    )
