"""Solution of a problem: in memory or, if the frames do not fit, on some and then on all.

    scan of all frames
         -> the usual schedule on representative frames
         -> a polish on as many frames as fit into memory, since representative ones are extreme
         -> passes over all frames, each an exact alternation, until one gains little

The passes call a function for every span of frames, in this process or in the workers of a cluster,
and sum the results in the order of the spans, so that the sum does not depend on which worker
computed a part.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import partial

from ..problem.answer import Step, outcome_of, skinning_of
from ..problem.problem import Initial, Problem
from ..problem.scan import Scan, needs_streaming, scan, subset
from ..result import Decomposition
from ..sequence import MeshSequence
from ..solver.model import Model
from ..solver.objective import WeightSmoothness
from ..solver.trajectories import Trajectories, gather
from .descent import Descent, Schedule
from .passes import ENTERING, AllFrames, carried
from .schedules import follow_effort, settle

# Fractions of the work that are done after the scan, after the run on representative frames, and
# after the run on more frames, as measured for sequences of the paper's size.
SCANNED, _REPRESENTED, _SETTLED = 0.05, 0.3, 0.5
# Most passes over all frames.  At the paper's size a second pass gains nothing.
PASSES = {"fast": 1, "balanced": 1, "best": 4}


def solve(problem: Problem, schedule: Schedule | None = None) -> Decomposition:
    """Solve a problem by the schedule of its effort, or by `schedule` if that is given.

    With a given `schedule`, all frames are held in memory.

    Raises
    ------
    Cancelled
        If the callback stopped the run before there was any model.
    """
    if schedule is None and needs_streaming(problem.sequences):
        return _solve_streamed(problem)
    sequences, data, initial = read_frames(problem, None)
    d = _begin(problem, data, initial, normals=True)
    del data  # frees the frames once they have been compressed
    reason = d.follow(schedule or _schedule_of(problem), _report(problem, d, sequences))
    reason, records = problem.monitor.stopped or reason, list(d.records)
    return outcome_of(
        problem, d.data.alignment, d.best.model, records, reason=reason, removable=d.removable_bones
    )


def _solve_streamed(problem: Problem) -> Decomposition:
    """Solve a problem whose frames do not fit into memory.

    First, a model of representative frames is solved.  If more frames fit into memory, and the run
    is neither stopped nor out of time, the model is refined on these.  Passes over all frames
    follow.
    """
    monitor, chosen = problem.monitor, scan_of(problem)
    alignment, more = chosen.alignment, chosen.extended(problem.n_vertices)
    sequences, data, initial = read_frames(problem, chosen)
    # normals are solved in the last of the runs
    d = _begin(problem, data, initial, normals=more is None)
    del data
    with monitor.part(SCANNED, _REPRESENTED):
        reason = d.follow(_schedule_of(problem), _report(problem, d, sequences))
    later = problem
    if d.initial.transforms is None:  # those of a start may turn out to be of other frames
        initial = dataclasses.replace(problem.initial, transforms=None)
        later = dataclasses.replace(problem, initial=initial)
    if more is not None and monitor.stopped is None:
        d, sequences = _carried(later, d, chosen, more)
        chosen = more
        with monitor.part(_REPRESENTED, _SETTLED):
            last = partial(settle, effort=problem.effort)
            reason = d.follow(last, _report(problem, d, sequences))
    removable = d.removable_bones
    model, records = _passes_over_all(later, d, chosen, d.best.model)
    reason = monitor.stopped or reason
    return outcome_of(problem, alignment, model, records, reason=reason, removable=removable)


def scan_of(problem: Problem) -> Scan:
    """Scan all frames of a problem."""

    def report(done: float) -> None:
        problem.monitor.report(
            "scan", iteration=0, rmse=math.inf, fraction=SCANNED * done, ready=False
        )

    return scan(
        problem.sequences,
        problem.vertex_importance,
        [problem.initial.rest_frame or 0],
        executor=problem.executor,
        report=report,
    )


def read_frames(
    problem: Problem, chosen: Scan | None
) -> tuple[list[MeshSequence], Trajectories, Initial]:
    """Read the frames that a scan chose, or all frames if `chosen` is None.

    Returns the frames, their trajectories, and the given parts in the space of the trajectories.
    """
    sequences, initial = problem.sequences, problem.initial
    importance = problem.frame_importance
    if chosen is not None:
        sequences = [subset(sequences, chosen.chosen, executor=problem.executor)]
        importance, initial = chosen.importance(importance), initial.of_frames(chosen.chosen)
    data = gather(
        sequences,
        bones=problem.bones,
        vertex_importance=problem.vertex_importance,
        frame_importance=importance,
        compress=False,
    )
    return sequences, data, initial.inside(data.alignment)


def _begin(problem: Problem, data: Trajectories, initial: Initial, *, normals: bool) -> Descent:
    """A descent on the frames of `data`; a reference surface is chosen unless `data` has one."""
    if data.surface is None:
        data, initial = problem.with_rest_surface(data, initial)
    smoothness = WeightSmoothness.build(data, problem.sequences[0].faces, problem.smoothness)
    return Descent(
        data,
        bones=problem.bones,
        influences=min(problem.influences, problem.bones),
        rng=problem.rng,
        constraints=problem.constraints,
        initial=initial,
        smoothness=smoothness,
        monitor=problem.monitor,
        rigid_joints=problem.rig == "rigid",
        normals=normals and problem.normals and smoothness is None,
    )


def _schedule_of(problem: Problem) -> Schedule:
    """Schedule of the problem's effort."""
    return partial(
        follow_effort,
        effort=problem.effort,
        rig=problem.rig,
        bones_placed=problem.bones_placed,
        tries_model=problem.tries_model,
    )


def _report(problem: Problem, d: Descent, sequences: list[MeshSequence]) -> Callable[[str], None]:
    """Function that reports a step to the monitor and offers it the best model of `sequences`."""
    monitor = problem.monitor

    def report(phase: str) -> None:
        ready = d.best.exists
        if ready:
            monitor.offer(
                lambda: skinning_of(problem, d.data.alignment, d.best_of_all().model, sequences)
            )
        rmse = d.data.rmse(d.best_error)
        monitor.report(phase, iteration=d.iteration, rmse=rmse, fraction=d.fraction, ready=ready)

    return report


def _carried(
    problem: Problem, first: Descent, few: Scan, more: Scan
) -> tuple[Descent, list[MeshSequence]]:
    """Begin a descent on more frames from the representative frames' model; release `first`.

    Representative frames are few and extreme; solved on these alone, the weights follow motion that
    other frames do not have.  Returns the descent and its frames.
    """
    first.release()
    sequences, data, initial = read_frames(problem, more)
    ratio = first.data.alignment.scale / data.alignment.scale
    if first.data.surface is not None:
        data = dataclasses.replace(data, surface=first.data.surface.scaled(ratio))
    d = _begin(problem, data, initial, normals=True)
    d.iteration = first.iteration
    nearest = few.nearest[more.chosen]
    d.model = carried(first.best.model, nearest, ratio, initial)
    return d, sequences


def _passes_over_all(
    problem: Problem, d: Descent, chosen: Scan, model: Model
) -> tuple[Model, list[Step]]:
    """Make passes over all frames, starting from `model`, until a pass gains little.

    `model` was solved on the frames `chosen`.  Returns the last model and a record of each pass.
    """
    monitor, most, constraints = problem.monitor, PASSES[problem.effort], problem.constraints
    if d.smoothness is not None:  # a pass ignores the penalty, so it must not change the weights
        constraints = constraints.with_weights(d.data.n_vertices)
    frames = AllFrames(
        problem.sequences,
        chosen,
        d.data,
        model,
        constraints=constraints,
        initial=problem.initial.inside(chosen.alignment),
        importance=problem.frame_importance,
        executor=problem.executor,
    )
    d.release()
    passes: list[Step] = []

    def report(done: float) -> None:
        monitor.report(
            "all frames",
            iteration=d.iteration + len(passes),
            rmse=frames.space.rmse(passes[-1][2]) if passes else math.inf,
            fraction=_SETTLED + (1 - _SETTLED) * (len(passes) + done) / most,
        )

    entering = 0 if d.smoothness else ENTERING
    for _ in frames.improve(most, entering=entering, report=report):
        error = frames.model.weighted_error(frames.space)
        passes.append((d.iteration + len(passes) + 1, monitor.elapsed, error, "all frames"))
        monitor.offer(lambda: skinning_of(problem, frames.alignment, frames.model))
    return frames.model, passes
