"""Driver for frames that do not fit into memory: solve on some, finish on all.

    scan of all frames
         -> the usual run on representative frames
         -> a polish on as many frames as fit into memory, since representative ones are extreme
         -> passes over all frames, each an exact alternation, until one gains little

A loop over all frames calls a function for every span of them, in this process or in the workers of
a cluster, and sums the results in the order of the spans, so that the sum does not depend on which
worker computed a part.
"""

from __future__ import annotations

import dataclasses
import math
from functools import partial

import numpy as np

from ..errors import Cancelled, InputError
from ..problem.answer import Step, outcome_of, skinning_of
from ..problem.initial import Given
from ..problem.problem import Problem
from ..problem.progress import Clock, ProgressReport
from ..problem.scan import Scan, scan, subset
from ..result import Decomposition
from ..sequence import MeshSequence
from ..skinning import Skinning
from ..solver.model import Model
from ..solver.trajectories import Array, Trajectories
from .descent import Descent
from .passes import ENTERING, AllFrames, carried
from .schedules import settle
from .solve import after_step, begin, schedule_of
from .weight_rounding import rounded_best

__all__ = ["PASSES", "SCANNED", "scan_of", "solve"]

# Fractions of the work that are done after the scan, after the run on representative frames, and
# after the run on more frames, as measured for sequences of the paper's size.
SCANNED, _REPRESENTED, _SETTLED = 0.05, 0.3, 0.5
# Most passes over all frames.  At the paper's size the first one ends where a second one stays.
PASSES = {"fast": 1, "balanced": 1, "best": 4}


def solve(problem: Problem) -> Decomposition:
    """Fit a model to representative frames, and improve it by passes over all frames.

    Between both it is refined on as many frames as fit into memory, if these are more, unless the
    run is stopped or out of time.

    Raises
    ------
    InputError
        If joints are locked, which is possible only for frames in memory.
    Cancelled
        If the callback stopped the run before there was any model.
    """
    if problem.given.rotations is not None:
        raise InputError("rig.locked_joints", "() for frames that are streamed", "some")
    clock = Clock()
    few = scan_of(problem, clock)
    more = few.extended(problem.n_vertices)
    importance = problem.frame_importance
    sequence, data, given = _read_chosen(problem, few, few.importance(importance))
    # normals are solved in the last of the runs
    first = problem if more is None else dataclasses.replace(problem, normals=False)
    d = begin(first, data, given, clock)
    del data  # frees the frames once they have been compressed
    report = ProgressReport(problem.callback, clock, problem.time_limit)
    told = after_step(problem, d, report, sequences=[sequence], part=(SCANNED, _REPRESENTED))
    reason = d.follow(schedule_of(problem), told)
    # the transforms of a start are dropped if they turned out to be of other frames
    given_later = problem.given
    if d.given.transforms is None:
        given_later = dataclasses.replace(given_later, transforms=None)
    later = dataclasses.replace(problem, given=given_later)
    chosen = few
    if more is not None and reason not in ("cancelled", "time limit"):
        chosen = more
        d.release()
        weights = None if importance is None else importance[more.chosen]
        sequence, data, given = _read_chosen(later, more, weights)
        d = _carried(later, few, more, d, data, given)
        told = after_step(problem, d, report, sequences=[sequence], part=(_REPRESENTED, _SETTLED))
        reason = d.follow(partial(settle, effort=problem.effort), told)
    idle = d.idle_bones
    model, _, reason = rounded_best(problem, d, report, reason)
    frames = _all_frames(later, chosen, d, model)
    d.release()
    passes, why = _passes(problem, d, frames, hurried=reason == "cancelled")
    return outcome_of(
        problem,
        few.alignment,
        frames.model,
        passes,
        reason=why or reason,
        idle=idle,
    )


def scan_of(problem: Problem, clock: Clock) -> Scan:
    """Scan all frames of a problem, and report the progress to the callback."""
    report = ProgressReport(problem.callback, clock, problem.time_limit)

    def on_progress(done: float) -> None:
        if report("scan", iteration=0, rmse=math.inf, fraction=SCANNED * done):
            raise Cancelled("stopped by the callback before there was any model")

    return scan(
        problem.sequences,
        problem.vertex_importance,
        [problem.given.rest_frame or 0],
        executor=problem.executor,
        on_progress=on_progress,
    )


def _read_chosen(
    problem: Problem, chosen: Scan, importance: Array | None
) -> tuple[MeshSequence, Trajectories, Given]:
    """Read the chosen frames; return them, their trajectories, and the given parts for them."""
    sequence = subset(problem.sequences, chosen.chosen, executor=problem.executor)
    data = problem.trajectories([sequence], importance)
    return sequence, data, problem.given.of_frames(chosen.chosen).inside(data)


def _carried(
    problem: Problem, few: Scan, more: Scan, first: Descent, data: Trajectories, given: Given
) -> Descent:
    """A descent that goes on from the model of the representative frames with more frames.

    Representative frames are few and extreme; solved on these alone, the weights follow motion that
    other frames do not have.
    """
    ratio = first.data.scale / data.scale
    if first.data.surface is not None:
        data = dataclasses.replace(data, surface=first.data.surface.scaled(ratio))
    d = begin(problem, data, given, first.clock)
    d.iteration = first.iteration
    d.model = carried(first.best_model, few.nearest[more.chosen], ratio, given, problem.locked)
    return d


def _all_frames(problem: Problem, chosen: Scan, d: Descent, model: Model) -> AllFrames:
    """Prepare the model of some frames for passes over all frames."""
    locked = problem.locked
    if d.smoothness is not None or problem.storage != "float32":
        # a pass knows neither penalty nor rounding, so that it must keep the weights
        locked = dataclasses.replace(locked, weights=np.ones(d.data.n_vertices, dtype=bool))
    return AllFrames(
        problem.sequences,
        chosen,
        d.data,
        model,
        locked=locked,
        given=problem.given.inside(chosen.alignment),
        importance=problem.frame_importance,
        executor=problem.executor,
    )


def _passes(
    problem: Problem, d: Descent, frames: AllFrames, *, hurried: bool
) -> tuple[list[Step], str | None]:
    """Make passes over all frames until one gains little; only one if `hurried`.

    Returns
    -------
    list of Step
        One for each pass.
    str or None
        "cancelled" or "time limit" if that ended the passes.
    """
    report = ProgressReport(problem.callback, d.clock, problem.time_limit)
    most = PASSES[problem.effort]
    unit = frames.alignment.scale / math.sqrt(problem.n_frames * problem.n_vertices)
    passes: list[Step] = []
    stopped = False

    def on_progress(done: float) -> None:
        nonlocal stopped
        stopped |= report(
            "all frames",
            iteration=d.iteration + len(passes),
            rmse=unit * math.sqrt(passes[-1][2]) if passes else math.inf,
            fraction=_SETTLED + (1 - _SETTLED) * (len(passes) + done) / most,
        )

    def model() -> Skinning:
        return skinning_of(problem, frames.alignment, frames.model)

    entering = 0 if d.smoothness else ENTERING
    for _ in frames.improve(most, entering=entering, on_progress=on_progress):
        step = d.iteration + len(passes) + 1
        error = frames.model.weighted_error(frames.space)
        passes.append((step, d.clock.elapsed, error, "all frames"))
        problem.checkpoint.offer(model)
        if hurried or stopped:
            break
        if report.out_of_time:
            return passes, "time limit"
    return passes, "cancelled" if stopped else None
