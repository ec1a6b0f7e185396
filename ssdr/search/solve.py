"""Driver for frames that fit into memory."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from functools import partial

from ..errors import Cancelled
from ..problem.answer import outcome_of, skinning_of
from ..problem.initial import Given
from ..problem.problem import Problem
from ..problem.progress import Clock, ProgressReport
from ..result import Decomposition
from ..sequence import MeshSequence
from ..solver.smoothness import WeightSmoothness
from ..solver.trajectories import Trajectories
from .descent import Descent, Schedule, Stop
from .schedules import follow_effort
from .weight_rounding import rounded_best

__all__ = ["after_step", "begin", "schedule_of", "solve"]

_logger = logging.getLogger(__name__)


def solve(problem: Problem, schedule: Schedule | None = None) -> Decomposition:
    """Solve a problem on all frames at once, by default with the schedule of its effort.

    Raises
    ------
    Cancelled
        If the callback stopped the run before there was any model.
    """
    clock = Clock()
    data = problem.trajectories(problem.sequences, problem.frame_importance)
    d = begin(problem, data, problem.given.inside(data), clock)
    del data  # frees the frames once they have been compressed
    report = ProgressReport(problem.callback, clock, problem.time_limit)
    reason = d.follow(schedule or schedule_of(problem), after_step(problem, d, report))
    model, steps, reason = rounded_best(problem, d, report, reason)
    return outcome_of(problem, d.data, model, steps, reason=reason, idle=d.idle_bones)


def schedule_of(problem: Problem) -> Schedule:
    """Schedule of the problem's effort."""
    return partial(
        follow_effort,
        effort=problem.effort,
        rig=problem.rig,
        placed=problem.placed,
        tries_model=problem.beside,
    )


def begin(problem: Problem, data: Trajectories, given: Given, clock: Clock) -> Descent:
    """A descent on the frames of `data`, whose rest pose keeps to the surface that it may have."""
    if data.surface is None:
        data, given = problem.with_rest_surface(data, given)
    smoothness = WeightSmoothness.build(data, problem.sequences[0].faces, problem.smoothness)
    return Descent(
        data,
        bones=problem.bones,
        influences=min(problem.influences, problem.bones),
        rng=problem.rng,
        locked=problem.locked,
        given=given,
        smoothness=smoothness,
        clock=clock,
        rigid_joints=problem.rig == "rigid",
        normals=problem.normals and smoothness is None,
    )


def after_step(
    problem: Problem,
    d: Descent,
    report: ProgressReport,
    *,
    sequences: list[MeshSequence] | None = None,
    part: tuple[float, float] = (0.0, 1.0),
) -> Callable[[str], None]:
    """Function that reports a step and writes checkpoints, and stops the descent if that is asked.

    Parameters
    ----------
    problem : Problem
    d : Descent
    report : ProgressReport
    sequences : list of MeshSequence, optional
        Frames of `d`, if these are not all.
    part : (float, float)
        Fractions of the whole work that are done before and after this descent.
    """
    unit = d.data.scale / math.sqrt(d.data.n_frames * d.data.n_vertices)

    def told(phase: str) -> None:
        rmse = unit * math.sqrt(d.best_error)
        fraction = part[0] + (part[1] - part[0]) * d.fraction
        said = phase, d.iteration, rmse, 100 * fraction
        _logger.debug("%s, iteration %d, rmse %.6g, %.0f %% done", *said)
        if d.best is not None:
            problem.checkpoint.offer(
                lambda: skinning_of(problem, d.data, d.best_of_all(), sequences)
            )
        if report(phase, iteration=d.iteration, rmse=rmse, fraction=fraction):
            if d.best is None:
                raise Cancelled("stopped by the callback before there was any model")
            raise Stop("cancelled")
        if d.best is not None and report.out_of_time:
            raise Stop("time limit")

    return told
