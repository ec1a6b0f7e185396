"""The driver for frames that fit into memory: steps until the schedule, a limit or the caller ends.

Its parts serve the streamed driver too, which makes two such runs and then its passes.
"""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..clips import names_of
from ..errors import Cancelled
from ..frames.digest import Digests
from ..frames.error import squared_error
from ..frames.executor import Executor
from ..hierarchy.tree import Tree
from ..joints.changes import loss_of_bones
from ..joints.mirror import mirror_of, side_names
from ..joints.placement import refit_joints, spanning_tree
from ..search.prescribed import Prescribed
from ..search.progress import Clock, Record, Reporter
from ..search.run import Run
from ..search.state import SolverState, check_settings, check_size, taking_up, whole
from ..skinning import Skinning
from ..solver.alternation import bone_costs
from ..solver.gauge import normalise_gauge
from ..solver.model import Model
from ..solver.trajectories import Alignment, Trajectories
from .problem import Problem
from .schedule import fingerprint, schedule_for

__all__ = [
    "Outcome",
    "begin",
    "hierarchy_of",
    "idle_bones",
    "outcome_of",
    "restore",
    "solve",
    "state_of",
    "walk",
    "with_tree",
]

_logger = logging.getLogger(__name__)
# Ratio of the true error to the objective's, beyond which they say different things: the error is
# then of vertices of next to no importance, and records keep the objective's.
_MOST_RATIO = 10.0
# Of the motion's energy: what solving for it leaves to rounding.  A bone whose loss costs less
# is idle.
_NO_LOSS = 1e-13


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """What a driver hands back to ``decompose``.

    Attributes
    ----------
    skinning : Skinning
    rmse : float
        Over all frames, measured by skinning.
    stop_reason : str
    history : tuple of Record
    state : SolverState
    warnings : tuple of str
    """

    skinning: Skinning
    rmse: float
    stop_reason: str
    history: tuple[Record, ...]
    state: SolverState
    warnings: tuple[str, ...] = ()


def solve(problem: Problem) -> Outcome:
    """Solve on all frames, in memory.

    Raises
    ------
    InputError
        If the state to resume from is of another run.
    Cancelled
        If the callback stopped the run before there was any model.
    """
    clock = Clock()
    data = problem.gather(problem.sequences, problem.frame_importance)
    run, settings = begin(problem, data, problem.prescribed.inside(data), clock)
    del data  # what a compressed run needs no longer is freed
    if problem.resume is not None:
        restore(run, problem.resume)

    def state() -> SolverState:
        return state_of(run, settings)

    checkpoint = problem.checkpoint
    reason = walk(
        run, problem, save=None if checkpoint is None else lambda: checkpoint.offer(state)
    )
    return outcome_of(
        problem,
        run.whole,
        run.best_model,
        run.records,
        importance=run.whole.importance,
        reason=reason,
        state=state(),
        idle=idle_bones(run),
    )


def begin(
    problem: Problem,
    data: Trajectories,
    prescribed: Prescribed,
    clock: Clock,
    digests: Digests | None = None,
) -> tuple[Run, dict[str, Any]]:
    """The effort's run, and the settings that a state of it carries.

    `digests` are those of all frames where a walk has made them already.

    Raises
    ------
    InputError
        If the state to resume from is of another run.
    """
    smoothness = problem.smoothness_of(data)
    schedule = schedule_for(
        problem.effort,
        fixed=problem.fixed,
        bones=problem.bones,
        prescribed=prescribed,
        smoothed=smoothness is not None,
        size=float(data.n_vertices) * data.n_frames * problem.bones,
        hierarchy=problem.hierarchy,
    )
    run = Run(
        data,
        schedule,
        bones=problem.bones,
        influences=min(problem.influences, problem.bones),
        rng=problem.rng,
        fixed=problem.fixed,
        prescribed=prescribed,
        smoothness=smoothness,
        clock=clock,
        rigid_joints=problem.hierarchy == "rigid",
    )
    settings = problem.settings(
        smoothness=problem.smoothness,
        input=problem.fingerprint(data, digests),
        schedule=fingerprint(schedule),
    )
    if problem.resume is not None:
        check_settings(problem.resume, settings)
    return run, settings


def walk(
    run: Run,
    problem: Problem,
    *,
    save: Callable[[], None] | None,
    part: tuple[float, float] = (0.0, 1.0),
) -> str:
    """Steps until the schedule, a limit or the caller ends it; says why.

    Parameters
    ----------
    run : Run
    problem : Problem
    save : callable or None
        Called after every step; may write a checkpoint.
    part : (float, float)
        Fractions of the whole work that are done before and after this run.

    Raises
    ------
    Cancelled
        If the callback stopped the run before there was any model.
    """
    unit = run.whole.scale / math.sqrt(run.whole.n_frames * run.whole.n_vertices)
    report = Reporter(problem.callback, run.clock, problem.time_limit)

    def limit() -> str | None:
        if run.best is None or run.finished:
            return None
        if problem.max_iterations is not None and run.iteration >= problem.max_iterations:
            return "iterations"
        return "time limit" if report.out_of_time else None

    def after_step(phase: str) -> str | None:
        rmse = unit * math.sqrt(run.best_value)
        _logger.debug("%s, iteration %d, rmse %.6g", phase, run.iteration, rmse)
        if save is not None:
            save()
        fraction = part[0] + (part[1] - part[0]) * run.fraction
        if report(phase, iteration=run.iteration, rmse=rmse, fraction=fraction):
            if run.best is None:
                raise Cancelled("stopped by the callback before there was any model")
            return "cancelled"
        return limit()

    reason = limit() or run.drive(after_step)
    return reason or ("converged" if run.converged else "plan finished")


def idle_bones(run: Run) -> int:
    """How many bones could each go at no loss."""
    wide = run.best_model.with_restarted_support()
    energy = float(run.whole.importance @ run.whole.x2)
    if wide.tree is None:
        costs = bone_costs(run.whole, wide)
    else:
        costs = np.array([loss.cost for loss in loss_of_bones(run.whole, wide)])
        # a joint that was asked not to turn says nothing of how many bones there are
        costs[[j for j, _, _ in run.asked.kept_rotations(wide.tree)]] = np.inf
    return int((costs <= _NO_LOSS * energy).sum())


def outcome_of(
    problem: Problem,
    alignment: Alignment,
    model: Model,
    records: list[tuple[int, float, float, str]],
    *,
    importance: np.ndarray,
    reason: str,
    state: SolverState,
    idle: int,
    executor: Executor | None = None,
) -> Outcome:
    """The model as a skinning in the input's space, with its true error.

    `records` hold squared errors in the solver's space.
    """
    padded = model.with_influences(problem.influences)
    indices, weights = padded.indices, padded.weights
    indices, weights = indices.copy(), weights.copy()  # the state has its own
    if problem.fixed.bone_model != "rigid":
        model = model.copy()  # the state has its own, so that resuming ends on the same bits
        normalise_gauge(model, importance, problem.fixed)
    rest, transforms = alignment.to_world(model.rest, model.transforms)
    squared = squared_error(
        problem.sequences, rest, indices, weights, transforms, executor=executor
    )
    count = alignment.n_frames * len(rest)
    rmse = math.sqrt(float(squared.sum()) / count)
    first = problem.sequences[0]
    tree = hierarchy_of(problem, model, alignment)
    skinning = Skinning(
        rest,
        indices,
        weights,
        transforms,
        faces=first.faces,
        bone_model=problem.fixed.bone_model,
        surface=first.surface,
        vertex_map=first.vertex_map,
        **names_of(problem.sequences),
    )
    if tree is not None:
        skinning = with_tree(skinning, tree, alignment, problem.names)
    values = np.array([value for _, _, value, _ in records])
    hint = f"{idle} of {problem.bones} bones could each go at no loss: fewer bones would do"
    return Outcome(
        skinning=skinning,
        rmse=rmse,
        stop_reason=reason,
        history=_history(records, alignment.scale * np.sqrt(np.maximum(values, 0.0) / count), rmse),
        state=state,
        warnings=(hint,) if idle else (),
    )


def hierarchy_of(problem: Problem, model: Model, alignment: Alignment) -> Tree | None:
    """The tree that a model's bones hang on, or over bones that were found without one."""
    if problem.hierarchy != "loose":
        return model.tree
    skeleton = problem.prescribed.inside(alignment).skeleton
    return spanning_tree(model, by_gap=True) if skeleton is None else refit_joints(model, skeleton)


def with_tree(
    skinning: Skinning, tree: Tree, alignment: Alignment, names: tuple[str, ...] = ()
) -> Skinning:
    """A skinning whose bones hang on the joints of a tree in the solver's space.

    `names` are those of the first bones.
    """
    positions, _ = alignment.to_world(tree.points, np.zeros((alignment.n_frames, 0, 3, 4)))
    roots = tree.roots
    positions[roots] = skinning.centroids()[roots]
    n_bones = skinning.n_bones
    mirror = None
    if not names:
        mirror = mirror_of(skinning.rest, skinning.indices, skinning.weights, n_bones)
    found = side_names(mirror, n_bones)
    return dataclasses.replace(
        skinning,
        parents=tree.parents,
        joint_positions=positions,
        bone_names=names + found[len(names) :],
    )


def _history(
    records: list[tuple[int, float, float, str]], errors: np.ndarray, rmse: float
) -> tuple[Record, ...]:
    """Records whose last error is the true one, measured on the frames.

    The reduced basis and importance change the objective, not which model is better: the
    others keep their ratio to the last, unless there is none to keep.
    """
    last = errors[-1]
    proportional = last > 0 and rmse < _MOST_RATIO * last
    errors = errors * (rmse / last) if proportional else errors
    # where joints are drawn to the skin a better model may have a little more error
    errors = np.maximum(np.minimum.accumulate(errors), rmse)
    errors[-1] = rmse
    return tuple(
        Record(iteration=iteration, elapsed=elapsed, rmse=float(error), phase=phase)
        for (iteration, elapsed, _, phase), error in zip(records, errors, strict=True)
    )


def state_of(
    run: Run,
    settings: dict[str, Any],
    progress: dict[str, Any] | None = None,
    driver: dict[str, Any] | None = None,
) -> SolverState:
    """The state of a run, with what its driver adds to `progress` and arrays of its own."""
    return SolverState(
        settings=settings,
        progress=run.progress() | (progress or {}),
        history=np.array([r[:3] for r in run.records], dtype=np.float64).reshape(-1, 3),
        phases=tuple(phase for _, _, _, phase in run.records),
        current=run.model,
        best=run.best,
        aside=run.aside,
        recycled=run.recycled,
        driver=driver or {},
    )


def restore(run: Run, state: SolverState) -> None:
    """Go on where a saved run was.

    Raises
    ------
    InputError
        If the state is of other frames, or damaged.
    """
    check_size(state.best, run.whole.n_vertices, run.whole.n_frames)
    with taking_up():
        run.go_to(whole(state.progress, "position"))
    for model in (state.current, state.aside):
        check_size(model, run.data.n_vertices, run.data.n_frames)
    with taking_up():
        if not (np.isfinite(state.history).all() and (state.history >= 0).all()):
            raise ValueError("history holds negative numbers, NaN or Inf")
        records = [
            (int(iteration), float(elapsed), float(value), phase)
            for (iteration, elapsed, value), phase in zip(state.history, state.phases, strict=True)
        ]
        run.restore(
            state.progress,
            None if state.current is None else state.current.copy(),
            None if state.best is None else state.best.copy(),
            None if state.aside is None else state.aside.copy(),
            records,
        )
        run.recycled = state.recycled
