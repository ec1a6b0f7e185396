"""Solution of a problem: in memory or, if the frames do not fit, on some and then on all.

    scan of all frames, which chooses those that differ most and evenly spread ones
         -> the usual schedule on the chosen frames
         -> one walk over all frames, which fits their bones, then weights and rest pose

A walk calls a function for every span of frames, in this process or in the workers of a cluster,
and uses the results in the order of the spans, so that nothing depends on which worker computed a
part.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import numpy as np

from ..mesh.clips import names_of
from ..mesh.normals import corner_normals
from ..model import frame_error
from ..model.drawn_normals import NormalErrors, errors_of_model, with_fitted_normals
from ..model.frame_error import motion_rms
from ..model.skinning import Skinning
from ..solver.alignment import Alignment
from ..solver.alternation import normalise_gauge
from ..solver.model import Model
from ..solver.objective import WeightSmoothness
from ..solver.trajectories import Trajectories, gather
from ..solver.warmup import compile_kernels
from .all_frames import fit_all_frames
from .descent import Descent, Schedule
from .problem import Effort, Initial, Problem
from .progress import Record
from .result import Decomposition
from .scan import Scan, needs_streaming, scan
from .schedules import follow_effort
from .steps import last_polish, unfold
from .trees.placement import refit_joints, spanning_tree

# Fractions of the work that are done after the scan, and after the run on chosen frames, as
# measured for sequences of the paper's size.
SCANNED, _SOLVED = 0.05, 0.8
_LAST: dict[Effort, int] = {"fast": 6, "balanced": 20, "best": 60}  # polish steps on chosen frames
# Largest ratio of the true error to that of the objective at which records are scaled to the true
# error.  A larger ratio means that the error is of vertices with almost no importance.
_MOST_RATIO = 10.0

# iteration, seconds, squared error and phase of an accepted model
Step = tuple[int, float, float, str]

Result = TypeVar("Result", bound=Decomposition)


def solve(problem: Problem, schedule: Schedule | None = None) -> Decomposition:
    """Solve a problem by the schedule of its effort, or by `schedule` if that is given.

    With a given `schedule`, all frames are held in memory.

    Raises
    ------
    Cancelled
        If the callback stopped the run before there was any model.
    """
    usual = partial(
        follow_effort,
        effort=problem.effort,
        rig=problem.rig,
        bones_placed=len(problem.constraints.weights) > 0,  # no bone has to find its place
        tries_model=problem.tries_model,
    )
    if schedule is None and problem.rig != "kept" and needs_streaming(problem.sequences):
        return _solve_streamed(problem, usual)
    d, reason = _descended(problem, schedule or usual)
    alignment, steps = d.data.alignment, list(d.records)
    warnings = _warnings(d, d.best.model)
    return outcome_of(problem, alignment, d.best.model, steps, reason=reason, warnings=warnings)


def _solve_streamed(problem: Problem, usual: Schedule) -> Decomposition:
    """Solve a problem on chosen frames, then fit the model to all frames."""
    monitor, chosen = problem.monitor, scan_of(problem, spread=True)
    importance = problem.frame_importance
    some = None if importance is None else importance[chosen.chosen]
    with monitor.part(SCANNED, _SOLVED):
        few = problem.of_frames(chosen.chosen, some)
        d, reason = _descended(few, partial(_of_chosen, usual=usual, effort=problem.effort))
    rmse = d.data.rmse(d.best_error)

    def report(done: float) -> None:
        fraction = _SOLVED + (1 - _SOLVED) * done
        monitor.report("all frames", iteration=d.work.iteration, rmse=rmse, fraction=fraction)

    alignment, model = fit_all_frames(problem, chosen, d.data, d.best.model, report=report)
    steps = [(d.work.iteration + 1, monitor.elapsed, model.weighted_error(d.data), "all frames")]
    reason = monitor.stopped or reason
    warnings = _warnings(d, model)
    return outcome_of(problem, alignment, model, steps, reason=reason, warnings=warnings)


def scan_of(problem: Problem, *, spread: bool) -> Scan:
    """Scan all frames of a problem; `spread` is that of :func:`~ssdr.search.scan.scan`."""

    def report(done: float) -> None:
        problem.monitor.report(
            "scan", iteration=0, rmse=math.inf, fraction=SCANNED * done, ready=False
        )

    return scan(
        problem.sequences,
        problem.vertex_importance,
        problem.initial.rest_frame or 0,
        spread=spread,
        executor=problem.executor,
        report=report,
    )


def gathered(problem: Problem) -> tuple[Trajectories, Initial]:
    """Trajectories of a problem with a reference surface, and the given parts in their space."""
    data = gather(
        problem.sequences,
        bones=problem.bones,
        vertex_importance=problem.vertex_importance,
        frame_importance=problem.frame_importance,
        compress=False,
    )
    return problem.with_rest_surface(data, problem.initial.inside(data.alignment))


def _descended(problem: Problem, schedule: Schedule) -> tuple[Descent, str]:
    """Follow a schedule on the frames of a problem; return the descent and why it ended."""
    data, initial = gathered(problem)
    monitor = problem.monitor
    smoothness = WeightSmoothness.build(data, problem.sequences[0].faces, problem.smoothness)
    d = Descent(
        data,
        bones=problem.bones,
        influences=min(problem.influences, problem.bones),
        rng=problem.rng,
        constraints=problem.constraints,
        initial=initial,
        smoothness=smoothness,
        monitor=monitor,
        rigid_joints=problem.rig == "rigid",
        normals=problem.normals if smoothness is None else None,
    )
    del data  # frees the frames once they have been compressed

    def report(phase: str) -> None:
        ready = d.best.exists
        if ready:
            monitor.offer(lambda: skinning_of(problem, d.data.alignment, d.best_of_all().model))
        rmse = d.data.rmse(d.best_error)
        monitor.report(
            phase, iteration=d.work.iteration, rmse=rmse, fraction=d.fraction, ready=ready
        )

    reason = d.follow(schedule, report)
    return d, monitor.stopped or reason


def _of_chosen(d: Descent, usual: Schedule, effort: Effort) -> None:
    """The usual schedule for positions alone, then few steps with normals.

    More steps with normals would fit those of the chosen frames at the cost of positions.
    """
    normals, d.normals = d.normals, None
    usual(d)
    d.normals = normals
    if d.smoothness is None:
        last_polish(d, steps=_LAST[effort], gain=0.002)
        unfold(d)


# --- the best model in the input's space, with its true error ----------------------------------


def skinning_of(problem: Problem, alignment: Alignment, model: Model) -> Skinning:
    """Convert a model to a skinning in the input's space, with the faces and names of the input.

    The skinning's normals are those of the rest pose, if the input has any: :func:`with_normals`
    fits better ones.
    """
    skin = dataclasses.replace(model, transforms=model.transforms[:0])
    padded = skin.with_influences(problem.influences)
    if problem.constraints.bone_model != "rigid" and problem.rig != "kept":
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
    warnings: tuple[str, ...],
) -> Decomposition:
    """Outcome of a run: the model in the input's space, its true error, and the history.

    If the call was given a start model that it may return unchanged (see `_is_an_answer`), and the
    error of that model is less, the start model is returned instead. `steps` hold squared errors in
    the solver's space.
    """
    count = problem.n_frames * problem.n_vertices
    inputs, executor = problem.inputs, problem.executor
    skinning = skinning_of(problem, alignment, model)
    parts = skinning.rest, skinning.indices, skinning.weights, skinning.transforms
    rmse = frame_error.rmse(inputs, *parts, executor=executor)
    if problem.start is not None and _is_an_answer(problem, problem.start):
        start = _start_as_result(problem, skinning)
        parts = start.rest, start.indices, start.weights, start.transforms
        before = frame_error.rmse(inputs, *parts, executor=executor)
        if before < rmse:
            skinning, rmse = start, before
    skinning, normals = with_normals(problem, skinning)
    values = np.array([value for _, _, value, _ in steps])
    return Decomposition(
        skinning=skinning,
        rmse=rmse,
        stop_reason=reason,
        history=_history(steps, alignment.scale * np.sqrt(np.maximum(values, 0.0) / count), rmse),
        offsets=problem.offsets,
        normals=normals,
        motion=motion_rms(inputs, executor=executor),
        copies=problem.copies,
        warnings=warnings,
    )


def _warnings(d: Descent, model: Model) -> tuple[str, ...]:
    """Warnings about bones that are not needed, and about folds of the rest pose of `model`."""
    found, surface = [], d.data.surface
    removable = d.removable_bones
    if removable == d.bones > 1:
        found.append("nothing moves but the mesh as a whole: all bones could each go at no loss")
    elif removable:
        found.append(
            f"{removable} of {d.bones} bones could each go at no loss: fewer bones would do"
        )
    turned = 0 if surface is None else int(surface.turned(model.rest, d.data.faces).sum())
    if turned:
        count = "1 triangle is" if turned == 1 else f"{turned} triangles are"
        found.append(
            f"{count} turned over in the rest pose: turning all of them back would raise the "
            "error by more than 2 %, or the run was stopped before"
        )
    return tuple(found)


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
    problem.monitor.began += seconds  # this time does not count
    result = dataclasses.replace(solve(problem), compile_seconds=seconds)
    problem.monitor.offer(lambda: result.skinning, now=True)
    return result


def _is_an_answer(problem: Problem, start: Skinning) -> bool:
    """Whether the call may return its start model unchanged.

    It may if the model has all frames of the problem, the call has neither importances nor
    smoothness, nor an error that does not count, and, for a rigid rig, the given tree is rigid.
    """
    plain = not problem.weighted and not problem.normals
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
    if problem.rig in ("kept", "loose") and tree is not None:
        tree = tree if problem.rig == "kept" else refit_joints(skinning.transforms, tree)
        joints = tree.points
    else:
        tree = model.hierarchy if problem.rig == "rigid" else spanning_tree(model, by_gap=True)
        joints = alignment.points_to_world(tree.points)
    if problem.rig != "kept":
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
    iterations, elapsed, _, phases = zip(*steps, strict=True)
    return tuple(map(Record, iterations, elapsed, errors.tolist(), phases))
