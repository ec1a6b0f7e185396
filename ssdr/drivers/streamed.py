"""The driver for frames that do not fit into memory: solve on some, finish on all.

    scan of all frames -> the usual run on the representative ones
         -> the polish on as many as may be held: few and extreme frames leave something open
         -> passes over all frames, each an exact alternation, while they pay

Each walk over the frames is a function of a span of them, called here or by the workers of a
cluster, and a sum in the order of the spans: the result does not depend on who works.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from ..errors import Cancelled
from ..frames.digest import check_same, digests_of, of_block
from ..frames.executor import Executor, executor_for
from ..search.prescribed import Prescribed
from ..search.progress import Clock, Reporter
from ..search.run import Run
from ..search.state import SolverState
from ..solver.trajectories import Array, Trajectories
from .in_memory import Outcome, begin, idle_bones, outcome_of, restore, state_of, walk
from .passes import ENTERING, GAIN, AllFrames, carried
from .problem import Problem
from .scan import Scan, scan, subset
from .schedule import settling_schedule
from .streamed_state import StreamedState

__all__ = ["PASSES", "SCANNED", "scan_of", "solve"]

# Fractions of the work that are done after the scan, the run on representative frames, the run
# on more of them: as measured at the paper's size.
SCANNED, _REPRESENTED, _SETTLED = 0.05, 0.3, 0.5
PASSES = {"fast": 1, "balanced": 4, "best": 8}  # over all frames, at most


def solve(problem: Problem) -> Outcome:
    """Solve on representative frames, settle on more of them, finish on all.

    Raises
    ------
    InputError, FormatError
        If the state to resume from is of another run, or damaged.
    Cancelled
        If the callback stopped the run before there was any model.
    """
    clock = Clock()
    executor = executor_for(problem.sequences)
    streamed = None if problem.resume is None else StreamedState.of(problem.resume)
    resumed = streamed is not None and streamed.scan.alignment.n_frames == problem.n_frames
    if streamed is None or not resumed:
        streamed = StreamedState(scan_of(problem, clock, executor))
    few = streamed.scan
    more = few.extended(problem.n_vertices)
    if more is None:
        streamed.settling = False

    data, prescribed = _frames(
        problem, few, few.importance(problem.frame_importance), executor, resumed=resumed
    )
    run, settings = begin(problem, data, prescribed, clock, few.digests)
    del data  # what a compressed or released run needs no longer is freed
    if more is not None and streamed.settling:
        run = _settling(problem, few, more, run, executor, resumed=resumed)
    if problem.resume is not None:
        restore(run, problem.resume)
    # passes go on where they were only under a model that is not going to change
    if not (run.finished and (streamed.settling or more is None)):
        streamed.passes, streamed.model, streamed.done = [], None, False

    def state() -> SolverState:
        return state_of(run, settings, streamed.progress(), streamed.arrays())

    checkpoint = problem.checkpoint
    offer = None if checkpoint is None else lambda: checkpoint.offer(state)
    before = SCANNED if not streamed.settling else _REPRESENTED
    after = _REPRESENTED if more is not None and not streamed.settling else _SETTLED
    reason = walk(run, problem, save=offer, part=(before, after))
    if more is not None and not streamed.settling and run.finished and reason != "cancelled":
        run = _settling(problem, few, more, run, executor, resumed=resumed)
        streamed.settling = True
        reason = walk(run, problem, save=offer, part=(_REPRESENTED, _SETTLED))
    idle = idle_bones(run)

    if resumed and streamed.done:  # no pass will read the frames
        check_same(
            digests_of(problem.sequences, executor),
            few.digests,
            range(problem.n_frames),
            resumed=resumed,
        )
    chosen = more if streamed.settling and more is not None else few
    frames = _all_frames(problem, chosen, run, executor, resumed=resumed)
    run.release()
    hurried = reason in ("cancelled", "iterations")
    save = None if checkpoint is None else lambda: checkpoint.save(state())
    reason = _passes(problem, run, frames, streamed, save, hurried=hurried) or reason
    assert streamed.model is not None
    return outcome_of(
        problem,
        few.alignment,
        streamed.model,
        [(*record, "all frames") for record in streamed.passes],
        importance=run.whole.importance,
        reason=reason,
        state=state(),
        idle=idle,
        executor=executor,
    )


def scan_of(problem: Problem, clock: Clock, executor: Executor) -> Scan:
    """The first walk over the frames, reported."""
    report = Reporter(problem.callback, clock, problem.time_limit)

    def on_progress(done: float) -> None:
        if report("scan", iteration=0, rmse=math.inf, fraction=SCANNED * done):
            raise Cancelled("stopped by the callback before there was any model")

    return scan(
        problem.sequences,
        problem.vertex_importance,
        [problem.prescribed.rest_frame],
        executor=executor,
        on_progress=on_progress,
    )


def _frames(
    problem: Problem,
    chosen: Scan,
    importance: Array | None,
    executor: Executor,
    *,
    resumed: bool,
) -> tuple[Trajectories, Prescribed]:
    """The chosen frames in memory, and what was prescribed of them.

    Raises
    ------
    InputError
        If one of them is not the one that was scanned.
    """
    sequence = subset(problem.sequences, chosen.chosen, executor=executor)
    seen, expected = of_block(sequence.vertices), chosen.digests[chosen.chosen]
    check_same(seen, expected, chosen.chosen, resumed=resumed)
    data = problem.gather([sequence], importance)
    return data, problem.prescribed.of_frames(chosen.chosen).inside(data)


def _settling(
    problem: Problem, few: Scan, more: Scan, first: Run, executor: Executor, *, resumed: bool
) -> Run:
    """What settles the model of representative frames on more of them.

    Representative frames alone, few and extreme, lead weights to follow what only they do.
    """
    first.release()
    importance = problem.frame_importance
    data, prescribed = _frames(
        problem,
        more,
        None if importance is None else importance[more.chosen],
        executor,
        resumed=resumed,
    )
    smoothness = problem.smoothness_of(data)
    schedule = settling_schedule(problem.effort, smoothed=smoothness is not None)
    run = first.followed_by(data, schedule, prescribed, smoothness)
    if first.best is not None:  # else it is restored
        run.model = carried(
            first.best,
            few.nearest[more.chosen],
            first.data.scale / data.scale,
            prescribed.transforms,
            problem.fixed,
        )
    return run


def _all_frames(
    problem: Problem, chosen: Scan, run: Run, executor: Executor, *, resumed: bool
) -> AllFrames:
    """The model of a run on some frames, ready for passes over all of them."""
    fixed = problem.fixed
    if run.smoothness is not None:
        # a pass knows nothing of the penalty: weights stay as the run left them
        fixed = dataclasses.replace(fixed, weights=np.ones(run.whole.n_vertices, dtype=bool))
    return AllFrames(
        problem.sequences,
        chosen,
        run.whole,
        run.best_model,
        fixed=fixed,
        prescribed=problem.prescribed.inside(chosen.alignment).transforms,
        importance=problem.frame_importance,
        executor=executor,
        resumed=resumed,
    )


def _passes(
    problem: Problem,
    run: Run,
    frames: AllFrames,
    streamed: StreamedState,
    save: Callable[[], None] | None,
    *,
    hurried: bool,
) -> str | None:
    """Passes until they do not pay, one if `hurried`; why they ended before that, if they did."""
    if streamed.model is None:
        streamed.model = frames.model
    else:
        frames.restore(streamed.model.copy(), len(streamed.passes))
    report = Reporter(problem.callback, run.clock, problem.time_limit)
    most = PASSES[problem.effort]
    unit = frames.alignment.scale / math.sqrt(problem.n_frames * problem.n_vertices)
    stopped = False

    def on_progress(done: float) -> None:
        nonlocal stopped
        count = len(streamed.passes)
        value = streamed.passes[-1][2] if streamed.passes else math.inf
        stopped |= report(
            "all frames",
            iteration=run.iteration + count,
            rmse=unit * math.sqrt(value),
            fraction=_SETTLED + (1 - _SETTLED) * (count + done) / most,
        )

    while not (streamed.done or stopped):
        count = len(streamed.passes)
        last = streamed.passes[-1][2] if streamed.passes else math.inf
        value = frames.pass_over(
            entering=0 if run.smoothness else ENTERING, on_progress=on_progress
        )
        if value >= last:
            streamed.done = True
            frames.restore(streamed.model, count)
            break
        streamed.passes.append((run.iteration + count + 1, run.clock.elapsed, value))
        streamed.done = value > (1 - GAIN) * last or count + 1 >= most
        streamed.model = frames.model if streamed.done else frames.model.copy()
        if save is not None and not streamed.done:
            save()
        if streamed.done or hurried:
            break
        if problem.max_iterations is not None and run.iteration + count + 1 >= (
            problem.max_iterations
        ):
            return "iterations"
        if report.out_of_time and not stopped:
            return "time limit"
    return "cancelled" if stopped else None
