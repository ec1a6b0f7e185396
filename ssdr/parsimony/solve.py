"""``ssdr.decompose(..., tolerance=...)``: the smallest model that is good enough."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import parse_tolerance
from ..errors import Cancelled, InputError, SsdrWarning
from ..parallel import serial_blas
from ..result import Decomposition
from ..search.problem import Parts, fingerprint, normalise
from ..search.progress import Progress, Record
from ..search.state import SolverState, check_settings, check_size, taking_up
from ..sequence import MeshSequence
from ..skinning import Skinning
from ..solver.model import Fixed, Model, pad_influences
from ..solver.trajectories import Array, Trajectories, gather
from ..streaming.passes import PASSES, AllFrames
from ..streaming.scan import Scan, needs_streaming, scan, subset
from .fewest_bones import Search, Stopped
from .pruning import Room, Truth
from .rank import rank_bound, rank_of, reduced
from .report import Measure, Parsimony, Pruning, bytes_of, size

__all__ = [
    "MOST_BONES",
    "decompose_within",
]

MOST_BONES = 256  # what an index of 8 bits tells apart
_ROUNDING = 1e-13  # of the largest coordinate: an error below is none
_LEAST_IMPORTANCE = 1e-4  # of the largest: what counts for less is not held by any search
_IMPROVE = {"fast": 0, "balanced": 16, "best": 60}
_RETRIES = 4


class _Task:
    """One call: its input, its limits, and the way from the solver's models to skinnings."""

    def __init__(
        self,
        sequences: list[MeshSequence],
        parts: Parts,
        *,
        tolerance: Any,
        measure: Measure,
        bones: int,
        influences: int,
        effort: str,
        bone_model: Any,
        rng: np.random.Generator,
        rest_frame: int,
        importance: Array | None,
        frame_importance: Array | None,
        max_iterations: int | None,
        time_limit: float | None,
        callback: Callable[[Progress], bool | None] | None,
    ) -> None:
        self.sequences, self.effort, self.bone_model = sequences, effort, bone_model
        self.rng, self.influences, self.measure = rng, influences, measure
        self.max_iterations, self.time_limit, self.callback = max_iterations, time_limit, callback
        self.frame_importance = frame_importance
        self.diagonal = max(s.diagonal() for s in sequences)
        self.asked = parse_tolerance(tolerance, self.diagonal)
        self.began, self.before = time.perf_counter(), 0.0
        self.parts = parts
        self.truth = Truth(sequences, measure)
        self.found: Scan | None = None
        solved, weights, start = sequences, frame_importance, rest_frame
        if needs_streaming(sequences):
            self.found = scan(sequences, importance, keep=[rest_frame])
            solved = [subset(sequences, self.found.chosen)]
            weights = self.found.importance(frame_importance)
            start = int(np.searchsorted(self.found.chosen, rest_frame))
        self.solved = Truth(solved, measure)
        data = gather(solved, bones=bones, vertex_importance=importance, frame_importance=weights)
        self.input = fingerprint(data, parts)
        largest = max(float(np.abs(data.centre).max()), data.scale)
        self.tolerance = max(self.asked, _ROUNDING * largest)
        count = data.n_frames * data.n_vertices
        allowed = (self.tolerance / data.scale) ** 2 * count
        plain = importance is None and frame_importance is None and self.found is None
        with serial_blas():
            self.least = rank_bound(data, allowed) if plain else 1
            # a joint that two bones share takes one from 4B − 1: at least 3B is left
            exact = -(-rank_of(data, 0.0) // 3) if plain else 0
        if exact > 2 * self.least + 1:
            exact = 0
        self.data: Trajectories = reduced(data, allowed)
        self.fixed = Fixed(rest=parts.rest is not None, bone_model=bone_model)
        self.records: list[Record] = []
        self.accepted: list[tuple[int, float, int]] = []
        self.progress = 0.0
        self.search = Search(
            self.data, tolerance=self.tolerance, measure=measure, error=self.error,
            least=self.least, most=bones, exact=exact, influences=influences, effort=effort,
            rng=rng, fixed=self.fixed, given=normalise(data, parts, start), step=self.step,
            accept=self.accept,
        )  # fmt: skip

    @property
    def elapsed(self) -> float:
        return self.before + time.perf_counter() - self.began

    def step(self, phase: str, iteration: int, share: float) -> str | None:
        """Tell the caller; the reason to stop, if there is one."""
        self.progress = max(self.progress, share)
        if self.max_iterations is not None and iteration >= self.max_iterations:
            return "iterations"
        here = time.perf_counter() - self.began
        if self.time_limit is not None and here >= self.time_limit:
            return "time limit"
        if self.callback is None:
            return None
        left = here * (1 - self.progress) / max(self.progress, 1e-3)
        if self.time_limit is not None:
            left = min(left, self.time_limit - here)
        told = Progress(
            phase=phase, iteration=iteration, elapsed=self.elapsed, rmse=self.search.held_error,
            fraction=self.progress, time_left=left,
        )  # fmt: skip
        return "cancelled" if self.callback(told) else None

    def error(self, model: Model) -> float:
        """Of a model in the search; over all frames where all of them are in memory."""
        if self.found is not None and self.measure == "rmse":
            # telling frames count as often as there are frames like them
            share = model.objective(self.data) / (self.data.n_frames * self.data.n_vertices)
            return self.data.scale * math.sqrt(max(share, 0.0))
        return self.solved(self.skinning(model))

    def accept(self, model: Model, error: float) -> None:
        s = self.skinning(model)
        rmse = error if self.measure == "rmse" else self.solved.rmse(s)
        frames = int(self.offsets[-1])
        used = int(np.count_nonzero(s.weights))
        keys = np.full(s.n_bones, frames)
        stored = bytes_of(s.n_vertices, used, frames, keys, s.bone_model).total
        self.accepted.append((model.n_bones, error, stored))
        self.note(rmse, "bones")

    def note(self, rmse: float, phase: str) -> None:
        self.records.append(
            Record(iteration=self.search.iteration, elapsed=self.elapsed, rmse=rmse, phase=phase)
        )

    def skinning(self, model: Model) -> Skinning:
        """A model of the frames that the search sees."""
        rest, transforms = self.data.to_world(model.rest, model.transforms)
        return self.named(rest, model, transforms)

    def named(self, rest: Array, model: Model, transforms: Array) -> Skinning:
        most = max(1, int((model.weights > 0).sum(axis=1).max()))
        joints, weights = pad_influences(model, self.influences)
        first = self.sequences[0]
        return Skinning(
            rest, joints[:, :most], weights[:, :most], transforms, faces=first.faces,
            fps=first.fps, surface=first.surface, vertex_map=first.vertex_map, name=first.name,
            bone_model=self.bone_model,
        )  # fmt: skip

    def whole(self, model: Model, *, passes: int, entering: int) -> Skinning:
        """A model of all frames, which are walked over where they were not in memory."""
        if self.found is None:
            return self.skinning(model)
        frames = AllFrames(
            self.sequences, self.found, self.data, model, fixed=self.fixed, given=None,
            importance=self.frame_importance,
        )  # fmt: skip
        last = math.inf
        for _ in range(passes):
            value = frames.pass_over(entering=entering)
            if not value < 0.998 * last:
                break
            last = value
        rest, transforms = frames.alignment.to_world(frames.model.rest, frames.model.transforms)
        return self.named(rest, frames.model, transforms)

    @property
    def offsets(self) -> NDArray[np.int64]:
        return np.cumsum([0, *[len(s) for s in self.sequences]])


def decompose_within(
    sequences: list[MeshSequence],
    parts: Parts,
    *,
    state: SolverState | None,
    ready: Callable[[], float],
    **options: Any,
) -> Decomposition:
    """The search, then what is superfluous in its outcome; arguments as checked by `decompose`.

    `ready` makes kernels ready and returns the seconds that this took.
    """
    for name in ("weights", "transforms"):
        if getattr(parts, name) is not None:
            raise InputError(name, "None beside a tolerance", "an array")
    if options.pop("smoothness") > 0:
        raise InputError("smoothness", "0 beside a tolerance", "more")
    parse_tolerance(options["tolerance"], 1.0)
    importance = options["importance"]
    if importance is not None and importance.min() < _LEAST_IMPORTANCE:
        raise InputError(
            "vertex_importance",
            f"numbers > 0 (at least {_LEAST_IMPORTANCE:g} of the largest) beside a tolerance, "
            "which bounds the plain error",
            f"{importance.min():.3g} of the largest",
        )
    compile_seconds = ready()
    task = _Task(sequences, parts, **options)
    search = task.search
    settings = {
        "tolerance": task.asked, "tolerance_of": task.measure, "bones": search.most,
        "influences": task.influences, "effort": task.effort, "bone_model": task.bone_model,
        "rest_frame": options["rest_frame"], "input": f"tolerance {task.input}",
    }  # fmt: skip
    start = None if state is None else _resumed(task, state, settings)
    prunings: list[Pruning] = []
    whole: Skinning | None = None
    reason = "tolerance held"
    try:
        whole = _solve(task, start)
        if search.held is not None and whole is not None:
            whole = _prune(task, whole, prunings)
    except Stopped as stop:
        reason = stop.reason
    if whole is None:
        model = search.held or search.closest
        if model is None:
            raise Cancelled("stopped by the callback before there was any model")
        whole = task.whole(model, passes=1, entering=3)
    error = task.truth(whole)
    held = error <= task.tolerance
    notes = []
    if not held:
        reason = "tolerance out of reach" if reason == "tolerance held" else reason
        notes.append(_answer(task, whole, error, reason))
    for note in notes:
        warnings.warn(note, SsdrWarning, stacklevel=4)
    rmse = task.truth.rmse(whole)
    task.note(rmse, "result")
    model = search.held or search.closest
    progress = {
        "elapsed": task.elapsed, "iteration": search.iteration, "rng": task.rng.bit_generator.state,
        "position": 0, "count": 0, "failures": 0, "damping": None, "recent": [], "settled": False,
        "best_value": 0.0 if model is None else model.objective(task.data),
    }  # fmt: skip
    records = task.records
    return Decomposition(
        skinning=whole, rmse=rmse, converged=reason == "tolerance held", stop_reason=reason,
        history=tuple(records), offsets=task.offsets,
        state=SolverState(
            settings=settings, progress=progress,
            history=np.array([[r.iteration, r.elapsed, r.rmse] for r in records]),
            phases=tuple(r.phase for r in records), current=model, best=search.held,
        ),
        compile_seconds=compile_seconds, warnings=tuple(notes),
        parsimony=Parsimony(
            tolerance=task.asked, tolerance_of=task.measure, error=error, held=held,
            bones=whole.n_bones, influences=whole.n_influences, least_bones=task.least,
            size=size(whole), prunings=tuple(prunings), attempts=tuple(search.attempts),
        ),
    )  # fmt: skip


def _solve(task: _Task, start: Model | None) -> Skinning | None:
    """The search; where it saw a part of the frames, again until all of them hold."""
    search = task.search
    passes = PASSES[task.effort]
    whole = None
    for _ in range(_RETRIES):
        search.run(start)
        if search.held is None:
            return whole
        search.improve(_IMPROVE[task.effort])
        whole = task.whole(search.held, passes=passes, entering=3)
        if task.found is None:
            return whole
        error = task.truth(whole)
        if error <= task.tolerance:
            return whole
        search.tighten(0.99 * task.tolerance / error)
        start = None
    return whole


def _prune(task: _Task, whole: Skinning, prunings: list[Pruning]) -> Skinning:
    search = task.search
    assert search.held is not None
    first, last = task.accepted[0], task.accepted[-1]
    prunings.append(Pruning("bones", first[0], last[0], first[2], last[2], first[1], last[1]))
    error = task.truth(whole)
    if not error <= task.tolerance:
        return whole
    room = Room(
        task.data, search.held, fixed=task.fixed, tolerance=task.tolerance, truth=task.truth,
        offsets=task.offsets, streamed=task.found is not None,
        whole=lambda model: task.whole(model, passes=1, entering=0),
        told=lambda: search.tell("pruning", 0.95),
    )  # fmt: skip
    fewer, keyed, losses = room.use(whole, error)
    prunings.extend(losses)
    task.note(task.truth.rmse(fewer), "influences")
    return keyed


def _resumed(task: _Task, state: SolverState, settings: dict[str, Any]) -> Model | None:
    check_settings(state, settings)
    check_size(state.best, task.data.n_vertices, task.data.n_frames)
    with taking_up():
        task.before = float(state.progress["elapsed"])
        task.search.iteration = int(state.progress["iteration"])
        task.rng.bit_generator.state = state.progress["rng"]
    return None if state.best is None else state.best.copy()


def _answer(task: _Task, whole: Skinning, error: float, reason: str) -> str:
    def text(value: float) -> str:
        share = f" ({100 * value / task.diagonal:.3g} % of the diagonal)" if task.diagonal else ""
        return f"{value:.4g}{share}"

    kind = {"rmse": "RMSE", "max": "largest error"}[task.measure]
    reached = f"{whole.n_bones} bones of at most {task.influences} influences reach a {kind} of"
    if reason == "tolerance out of reach":
        head = f"tolerance {text(task.asked)} is out of reach"
        if task.least > task.search.most:
            head += f", the motion's rank asks for at least {task.least} bones"
    else:
        head = f"stopped ({reason}) before tolerance {text(task.asked)} was held"
    return f"{head}: {reached} {text(error)}"
