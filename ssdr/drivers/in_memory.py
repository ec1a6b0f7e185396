"""Driver for frames that fit into memory."""

from __future__ import annotations

from ..result import Decomposition
from ..search.given import Given
from ..search.progress import Clock, ProgressReport
from ..search.run import Beside, Run, Schedule
from ..search.stages import Unfold
from ..solver.smoothness import WeightSmoothness
from ..solver.trajectories import Trajectories
from .hand_back import outcome_of, skinning_of
from .problem import Problem
from .rounding import rounded_best
from .schedule import from_model, normals_last, schedule_for

__all__ = ["begin", "solve"]


def solve(problem: Problem, schedule: Schedule | None = None) -> Decomposition:
    """Solve a problem on all frames at once, by default with the schedule of its effort.

    Raises
    ------
    Cancelled
        If the callback stopped the run before there was any model.
    """
    clock = Clock()
    data = problem.trajectories(problem.sequences, problem.frame_importance)
    run = begin(problem, data, problem.given.inside(data), clock, schedule)
    del data  # frees the frames once the run has compressed them
    report = ProgressReport(problem.callback, clock, problem.time_limit)
    reason = run.make_steps(
        report,
        save=lambda: problem.checkpoint.offer(
            lambda: skinning_of(problem, run.whole, run.best_model)
        ),
    )
    model, steps, reason = rounded_best(problem, run, report, reason)
    return outcome_of(problem, run.whole, model, steps, reason=reason, idle=run.idle_bones)


def begin(
    problem: Problem,
    data: Trajectories,
    given: Given,
    clock: Clock,
    schedule: Schedule | None = None,
) -> Run:
    """Begin a run on the frames of `data`, by default with the schedule of the problem's effort.

    The rest pose keeps to the surface that `data` may have.
    """
    if data.surface is None:
        data, given = problem.with_rest_surface(data, given)
    smoothness = WeightSmoothness.build(data, problem.sequences[0].faces, problem.smoothness)
    whole = schedule is None
    if schedule is None:
        schedule = schedule_for(
            problem.effort,
            bone_model=problem.locked.bone_model,
            bones=problem.bones,
            given=given,
            placed=problem.placed,
            smoothed=smoothness is not None,
            size=float(data.n_vertices) * data.n_frames * problem.bones,
            rig=problem.rig,
        )
    if problem.normals and smoothness is None:
        schedule = normals_last(schedule)
    if whole and problem.beside:
        schedule = (*schedule, Beside(start=from_model(problem.effort)))
    schedule = (*schedule, Unfold())
    return Run(
        data,
        schedule,
        bones=problem.bones,
        influences=min(problem.influences, problem.bones),
        rng=problem.rng,
        locked=problem.locked,
        given=given,
        smoothness=smoothness,
        clock=clock,
        rigid_joints=problem.rig == "rigid",
    )
