"""Solution of a problem: in memory or, if the frames do not fit, on some and then on all.

    scan of all frames, which chooses those that differ most and evenly spread ones
         -> the usual schedule on the chosen frames
         -> one walk over all frames, which fits their bones, then weights and rest pose

A walk calls a function for every span of frames, in this process or in the workers of a cluster,
and uses the results in the order of the spans, so that nothing depends on which worker computed a
part.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from ..solver.objective import WeightSmoothness
from ..solver.trajectories import Trajectories, gather
from .all_frames import fit_all_frames
from .descent import Descent, Schedule
from .outcome import outcome_of, skinning_of
from .problem import Effort, Initial, Problem
from .result import Decomposition
from .scan import Scan, needs_streaming, scan
from .schedules import follow_effort
from .steps import last_polish, unfold

# Fractions of the work that are done after the scan, and after the run on chosen frames, as
# measured for sequences of the paper's size.
SCANNED, _SOLVED = 0.05, 0.8
_LAST: dict[Effort, int] = {"fast": 6, "balanced": 20, "best": 60}  # polish steps on chosen frames


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
    d, reason = _descended(problem, schedule or _schedule_of(problem))
    alignment, steps = d.data.alignment, list(d.records)
    return outcome_of(
        problem, alignment, d.best.model, steps, reason=reason, removable=d.removable_bones
    )


def _solve_streamed(problem: Problem) -> Decomposition:
    """Solve a problem on chosen frames, then fit the model to all frames."""
    monitor, chosen = problem.monitor, scan_of(problem, spread=True)
    importance = problem.frame_importance
    some = None if importance is None else importance[chosen.chosen]
    with monitor.part(SCANNED, _SOLVED):
        few = problem.of_frames(chosen.chosen, some)
        d, reason = _descended(
            few, partial(_of_chosen, usual=_schedule_of(problem), effort=problem.effort)
        )
    rmse, removable = d.data.rmse(d.best_error), d.removable_bones

    def report(done: float) -> None:
        fraction = _SOLVED + (1 - _SOLVED) * done
        monitor.report("all frames", iteration=d.iteration, rmse=rmse, fraction=fraction)

    alignment, model = fit_all_frames(problem, chosen, d.data, d.best.model, report=report)
    steps = [(d.iteration + 1, monitor.elapsed, model.weighted_error(d.data), "all frames")]
    reason = monitor.stopped or reason
    return outcome_of(problem, alignment, model, steps, reason=reason, removable=removable)


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
    smoothness = WeightSmoothness.build(data, problem.sequences[0].faces, problem.smoothness)
    d = Descent(
        data,
        bones=problem.bones,
        influences=min(problem.influences, problem.bones),
        rng=problem.rng,
        constraints=problem.constraints,
        initial=initial,
        smoothness=smoothness,
        monitor=problem.monitor,
        rigid_joints=problem.rig == "rigid",
        normals=problem.normals and smoothness is None,
    )
    del data  # frees the frames once they have been compressed
    reason = d.follow(schedule, _report(problem, d))
    return d, problem.monitor.stopped or reason


def _of_chosen(d: Descent, usual: Schedule, effort: Effort) -> None:
    """The usual schedule for positions alone, then few steps with normals.

    More steps with normals would fit those of the chosen frames at the cost of positions.
    """
    normals, d.normals = d.normals, False
    usual(d)
    d.normals = normals
    if d.smoothness is None:
        last_polish(d, steps=_LAST[effort], gain=0.002)
        unfold(d)


def _schedule_of(problem: Problem) -> Schedule:
    """Schedule of the problem's effort."""
    return partial(
        follow_effort,
        effort=problem.effort,
        rig=problem.rig,
        bones_placed=problem.bones_placed,
        tries_model=problem.tries_model,
    )


def _report(problem: Problem, d: Descent) -> Callable[[str], None]:
    """Function that reports a step to the monitor and offers it the best model."""
    monitor = problem.monitor

    def report(phase: str) -> None:
        ready = d.best.exists
        if ready:
            monitor.offer(lambda: skinning_of(problem, d.data.alignment, d.best_of_all().model))
        rmse = d.data.rmse(d.best_error)
        monitor.report(phase, iteration=d.iteration, rmse=rmse, fraction=d.fraction, ready=ready)

    return report
