"""The driver for frames that fit into memory: steps until the schedule, a limit or the caller ends.

Its parts serve the streamed driver too, which makes two such runs and then its passes.
"""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Callable

import numpy as np

from ..clips import names_of
from ..errors import Cancelled
from ..frames.error import squared_error
from ..frames.executor import Executor
from ..hierarchy.tree import Tree
from ..joints.changes import removal_losses
from ..joints.mirror import mirror_of, side_names
from ..joints.placement import settled, spanning_tree
from ..search.given import Given
from ..search.progress import Clock, ProgressReport, Record
from ..search.run import Run, Schedule
from ..sequence import MeshSequence
from ..skinning import Skinning
from ..solver.alternation import bone_costs
from ..solver.bone_models import normalise_gauge
from ..solver.model import Model, pad_influences
from ..solver.trajectories import Alignment, Trajectories
from .problem import Problem
from .schedule import schedule_for

__all__ = ["Outcome", "begin", "idle_bones", "make_steps", "outcome_of", "skinning_of", "solve"]

_logger = logging.getLogger(__name__)
# Ratio of the true error to the objective's beyond which they say different things: the error then
# is of vertices of next to no importance, and records keep the objective's.
_MOST_RATIO = 10.0
# Relative to the motion's energy: what solving for it leaves to rounding.  A bone whose removal
# costs less is idle.
_NO_LOSS = 1e-13

# iteration, seconds, squared error and phase of an accepted model
Step = tuple[int, float, float, str]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """What a driver hands back.

    Attributes
    ----------
    skinning : Skinning
    rmse : float
        Over all frames, measured by skinning.
    stop_reason : str
    history : tuple of Record
    warnings : tuple of str
    """

    skinning: Skinning
    rmse: float
    stop_reason: str
    history: tuple[Record, ...]
    warnings: tuple[str, ...] = ()


def solve(problem: Problem) -> Outcome:
    """Solve on all frames, in memory.

    Raises
    ------
    Cancelled
        If the callback stopped the run before there was any model.
    """
    clock = Clock()
    data = problem.gather(problem.sequences, problem.frame_importance)
    run = begin(problem, data, problem.given.inside(data), clock)
    del data  # what a compressed run needs no longer is freed
    reason = make_steps(run, problem, save=lambda: skinning_of(problem, run.whole, run.best_model))
    return outcome_of(
        problem, run.whole, run.best_model, run.records, reason=reason, idle=idle_bones(run)
    )


def begin(
    problem: Problem,
    data: Trajectories,
    given: Given,
    clock: Clock,
    schedule: Schedule | None = None,
) -> Run:
    """A run on some frames; the schedule is the effort's by default."""
    smoothness = problem.smoothness_of(data)
    if schedule is None:
        schedule = schedule_for(
            problem.effort,
            fixed=problem.fixed,
            bones=problem.bones,
            given=given,
            smoothed=smoothness is not None,
            size=float(data.n_vertices) * data.n_frames * problem.bones,
            rig=problem.rig,
        )
    return Run(
        data,
        schedule,
        bones=problem.bones,
        influences=min(problem.influences, problem.bones),
        rng=problem.rng,
        fixed=problem.fixed,
        given=given,
        smoothness=smoothness,
        clock=clock,
        rigid_joints=problem.rig == "rigid",
    )


def make_steps(
    run: Run,
    problem: Problem,
    *,
    save: Callable[[], Skinning] | None,
    part: tuple[float, float] = (0.0, 1.0),
) -> str:
    """Steps until the schedule, the time limit or the caller ends them; returns the reason.

    Parameters
    ----------
    run : Run
    problem : Problem
    save : callable or None
        Makes the best model so far, for a checkpoint.
    part : (float, float)
        Fractions of the whole work that are done before and after this run.

    Raises
    ------
    Cancelled
        If the callback stopped the run before there was any model.
    """
    unit = run.whole.scale / math.sqrt(run.whole.n_frames * run.whole.n_vertices)
    report = ProgressReport(problem.callback, run.clock, problem.time_limit)

    def after_step(phase: str) -> str | None:
        rmse = unit * math.sqrt(run.best_value)
        _logger.debug("%s, iteration %d, rmse %.6g", phase, run.iteration, rmse)
        if save is not None and run.best is not None:
            problem.save(save)
        fraction = part[0] + (part[1] - part[0]) * run.fraction
        if report(phase, iteration=run.iteration, rmse=rmse, fraction=fraction):
            if run.best is None:
                raise Cancelled("stopped by the callback before there was any model")
            return "cancelled"
        return "time limit" if run.best is not None and report.out_of_time else None

    return run.drive(after_step) or ("converged" if run.converged else "effort spent")


def idle_bones(run: Run) -> int:
    """Number of bones that could each be removed at no loss."""
    wide = run.best_model.with_restarted_support()
    energy = float(run.whole.importance @ run.whole.x2)
    if wide.tree is None:
        costs = bone_costs(run.whole, wide)
    else:
        costs = np.array([loss.cost for loss in removal_losses(run.whole, wide)])
        # a joint that was asked not to turn says nothing of how many bones there are
        costs[[j for j, _, _ in run.asked.kept_turns(wide.tree)]] = np.inf
    return int((costs <= _NO_LOSS * energy).sum())


def skinning_of(
    problem: Problem,
    alignment: Alignment,
    model: Model,
    sequences: list[MeshSequence] | None = None,
) -> Skinning:
    """A model in the input's space, with what the input carries beside its shape.

    `sequences` are the frames that the model is of; all of them by default.
    """
    sequences = problem.sequences if sequences is None else sequences
    indices, weights = pad_influences(model, problem.influences)
    if problem.fixed.bone_model != "rigid":
        model = model.copy()
        importance = problem.vertex_importance
        equal = np.ones(len(model.rest))
        normalise_gauge(model, equal if importance is None else importance, problem.fixed)
    rest, transforms = alignment.to_world(model.rest, model.transforms)
    first = sequences[0]
    skinning = Skinning(
        rest,
        indices.copy(),
        weights.copy(),
        transforms,
        faces=first.faces,
        bone_model=problem.fixed.bone_model,
        surface=first.surface,
        vertex_map=first.vertex_map,
        **names_of(sequences),
    )
    tree = _tree_of(problem, model, alignment)
    return skinning if tree is None else _with_tree(skinning, tree, alignment, problem.names)


def outcome_of(
    problem: Problem,
    alignment: Alignment,
    model: Model,
    steps: list[Step],
    *,
    reason: str,
    idle: int,
    executor: Executor | None = None,
) -> Outcome:
    """The model in the input's space with its true error; never above the one it started from.

    `steps` hold squared errors in the solver's space.
    """
    count = problem.n_frames * problem.n_vertices

    def rmse_of(s: Skinning) -> float:
        parts = (s.rest, s.indices, s.weights, s.transforms)
        squared = squared_error(problem.sequences, *parts, executor=executor)
        return math.sqrt(float(squared.sum()) / count)

    skinning = skinning_of(problem, alignment, model)
    rmse = rmse_of(skinning)
    start = problem.start
    if start is not None and _is_an_answer(problem, start):
        before = rmse_of(start)
        if before < rmse:
            skinning, rmse = start, before
    values = np.array([value for _, _, value, _ in steps])
    hint = f"{idle} of {problem.bones} bones could each go at no loss: fewer bones would do"
    return Outcome(
        skinning=skinning,
        rmse=rmse,
        stop_reason=reason,
        history=_history(steps, alignment.scale * np.sqrt(np.maximum(values, 0.0) / count), rmse),
        warnings=(hint,) if idle else (),
    )


def _is_an_answer(problem: Problem, start: Skinning) -> bool:
    """Whether the model that a call starts from could be its result, judged by its error."""
    plain = problem.vertex_importance is None and problem.frame_importance is None
    rigid = problem.rig != "rigid" or (problem.given.tree is not None and problem.given.tree.rigid)
    frames = start.n_frames == problem.n_frames
    return plain and rigid and frames and problem.smoothness == 0


def _tree_of(problem: Problem, model: Model, alignment: Alignment) -> Tree | None:
    """The tree that a model's bones hang on, or over bones that were found without one."""
    if problem.rig == "none":
        return None
    if problem.rig == "rigid":
        return model.tree
    skeleton = problem.given.inside(alignment).tree
    return spanning_tree(model, by_gap=True) if skeleton is None else settled(model, skeleton)


def _with_tree(
    skinning: Skinning, tree: Tree, alignment: Alignment, names: tuple[str, ...]
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


def _history(steps: list[Step], errors: np.ndarray, rmse: float) -> tuple[Record, ...]:
    """Records whose last error is the true one, measured on the frames.

    The reduced basis and importance change the objective, not which model is better: the others
    keep their ratio to the last, unless there is none to keep.
    """
    last = errors[-1]
    proportional = last > 0 and rmse < _MOST_RATIO * last
    errors = errors * (rmse / last) if proportional else errors
    # where joints are drawn to the skin a better model may have a little more error
    errors = np.maximum(np.minimum.accumulate(errors), rmse)
    errors[-1] = rmse
    return tuple(
        Record(iteration=iteration, elapsed=elapsed, rmse=float(error), phase=phase)
        for (iteration, elapsed, _, phase), error in zip(steps, errors, strict=True)
    )
