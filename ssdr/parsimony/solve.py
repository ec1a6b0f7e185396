"""The driver for a tolerance: the fewest bones that hold it, then the fewest bytes."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from ..checks import LARGEST, parse_tolerance
from ..clips import names_of
from ..drivers.in_memory import Outcome, hierarchy_of, with_tree
from ..drivers.passes import ENTERING, GAIN, AllFrames
from ..drivers.problem import Problem
from ..drivers.scan import Scan, needs_streaming, subset
from ..drivers.streamed import PASSES, SCANNED, scan_of
from ..errors import Cancelled, InputError
from ..frames.executor import Executor, executor_for
from ..hierarchy.tree import Tree
from ..parallel import serial_blas
from ..search.progress import Clock, Record, Reporter
from ..search.state import SolverState, check_settings, check_size, number, taking_up, whole
from ..skinning import Skinning
from ..solver.model import Fixed, Model
from ..solver.trajectories import Alignment, Trajectories
from .fewest_bones import FewestBones, Stopped
from .fewest_joints import FewestJoints
from .pruning import ErrorBudget, TrueError
from .rank import rank_bound, rank_of, reduced
from .report import Parsimony, Pruning, bytes_of, key_bytes, size

__all__ = ["SmallestModel", "solve"]

_ROUNDING = 1e-13  # of the largest coordinate: an error below is none
_LOOSE = 10.0  # times the largest distance between vertices that there can be
# Polish steps of the model that holds: what they gain is error budget for pruning.
_IMPROVE = {"fast": 0, "balanced": 16, "best": 60}
_RETRIES = 4  # where the search sees a part of the frames, until all of them hold


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SmallestModel(Outcome):
    """An outcome that says how small a model the tolerance allows."""

    parsimony: Parsimony


def solve(problem: Problem) -> SmallestModel:
    """The smallest model that holds the tolerance, or the closest one.

    Raises
    ------
    InputError
        If the state to resume from is of another run, or damaged.
    Cancelled
        If the callback stopped the search before there was any model.
    """
    hunt = _Hunt(problem)
    start = None if problem.resume is None else hunt.restore(problem.resume)
    prunings: list[Pruning] = []
    skinning: Skinning | None = None
    reason = "tolerance held"
    try:
        skinning = hunt.fewest_bones(start)
        if hunt.search.held is not None and skinning is not None:
            skinning = hunt.fewest_bytes(skinning, prunings)
    except Stopped as stop:
        reason = stop.reason
        if skinning is None:
            skinning = hunt.latest
    if skinning is None:
        model = hunt.search.held or hunt.search.closest
        if model is None:
            raise Cancelled("stopped by the callback before there was any model")
        skinning = hunt.over_all_frames(model, passes=1, entering=ENTERING)
    error = hunt.true_error(skinning)
    held = error <= hunt.tolerance
    if not held and reason == "tolerance held":
        reason = "tolerance out of reach"
    rmse = hunt.true_error.rmse(skinning)
    hunt.record(rmse, "result")
    return SmallestModel(
        skinning=skinning,
        rmse=rmse,
        stop_reason=reason,
        history=tuple(hunt.records),
        state=hunt.state(),
        warnings=() if held else (hunt.shortfall(skinning, error, reason),),
        parsimony=Parsimony(
            tolerance=hunt.asked,
            tolerance_of=problem.tolerance_of,
            error=error,
            held=held,
            bones=skinning.n_bones,
            influences=skinning.n_influences,
            least_bones=hunt.least,
            size=size(skinning),
            prunings=tuple(prunings),
            attempts=tuple(hunt.search.attempts),
        ),
    )


class _Hunt:
    """One call: its frames, its limits, and the way from the solver's models to skinnings."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.clock = Clock()
        sequences, importance = problem.sequences, problem.frame_importance
        self.diagonal = max(s.diagonal() for s in sequences)
        self.asked = parse_tolerance(problem.tolerance, self.diagonal)
        self.report = Reporter(problem.callback, self.clock, problem.time_limit)
        self.scan: Scan | None = None
        self.executor: Executor | None = None
        prescribed = problem.prescribed
        if needs_streaming(sequences):
            self.executor = executor_for(sequences)
            self.scan = scan_of(problem, self.clock, self.executor)
            sequences = [subset(sequences, self.scan.chosen, executor=self.executor)]
            importance = self.scan.importance(importance)
            prescribed = prescribed.of_frames(self.scan.chosen)
        self.true_error = TrueError(problem.sequences, problem.tolerance_of, self.executor)
        self.solved_error = TrueError(sequences, problem.tolerance_of)
        data = problem.gather(sequences, importance, compress=True)
        digests = None if self.scan is None else self.scan.digests
        self.settings = problem.settings(
            tolerance=self.asked,
            tolerance_of=problem.tolerance_of,
            input=f"tolerance {problem.fingerprint(data, digests)}",
        )
        largest = max(float(np.abs(data.centre).max()), data.scale)
        if not largest < LARGEST:
            expected = f"coordinates of less than {LARGEST:g} beside a tolerance"
            raise InputError("sequence", expected, f"{largest:g}")
        count = data.n_frames * data.n_vertices
        # what no model misses bounds nothing, and its square need not be a number
        most = _LOOSE * data.scale * math.sqrt(count)
        self.tolerance = max(min(self.asked, most), _ROUNDING * largest)
        allowed = min(self.tolerance / data.scale, LARGEST) ** 2 * count
        self.least, exact = self._least_bones(data, allowed)
        self.data: Trajectories = reduced(data, allowed)
        self.fixed = Fixed(rest=problem.fixed.rest, bone_model=problem.fixed.bone_model)
        self.records: list[Record] = []
        self.smaller: list[tuple[int, float, int]] = []  # bones, error, bytes of each that held
        search = FewestJoints if problem.hierarchy == "rigid" else FewestBones
        self.search = search(
            self.data,
            tolerance=self.tolerance,
            measure=problem.tolerance_of,
            error=self.error,
            least=self.least,
            most=problem.bones,
            exact=exact,
            influences=problem.influences,
            effort=problem.effort,
            rng=problem.rng,
            fixed=self.fixed,
            prescribed=prescribed.inside(data),
            on_step=self.on_step,
            on_smaller=self.on_smaller,
        )
        self.search.fraction = 0.0 if self.scan is None else SCANNED
        # a pass is finished before the caller or a limit ends the search
        self.pending: str | None = None
        self.latest: Skinning | None = None  # of the pass that was the last one

    def _least_bones(self, data: Trajectories, allowed: float) -> tuple[int, int]:
        """The bound by the motion's rank, and how many bones exact skinning would need."""
        problem = self.problem
        weighted = problem.vertex_importance is not None or problem.frame_importance is not None
        if weighted or self.scan is not None:
            return 1, 0
        with serial_blas():
            least = rank_bound(data, allowed)
            # a joint that two bones share takes one from 4B − 1: at least 3B is left
            exact = -(-rank_of(data, 0.0) // 3)
        return least, 0 if exact > 2 * least + 1 else exact

    # --- what the search calls -----------------------------------------------------------------

    def on_step(self, phase: str, iteration: int, fraction: float) -> str | None:
        """Report; the reason to stop, if there is one."""
        if self.pending is not None:
            return self.pending
        most = self.problem.max_iterations
        if most is not None and iteration >= most:
            return "iterations"
        if self.report.out_of_time:
            return "time limit"
        rmse = self.search.held_error
        stop = self.report(phase, iteration=iteration, rmse=rmse, fraction=fraction)
        return "cancelled" if stop else None

    def on_progress(self, _: float) -> None:
        """Report from within a pass; a reason to stop holds once it is finished."""
        if self.pending is None:
            search = self.search
            self.pending = self.on_step("all frames", search.iteration, search.fraction)

    def error(self, model: Model) -> float:
        """Of a model in the search; over all frames where all of them are in memory."""
        if self.scan is not None and self.problem.tolerance_of == "rmse":
            # representative frames count as often as there are frames like them
            mean = model.weighted_error(self.data) / (self.data.n_frames * self.data.n_vertices)
            return self.data.scale * math.sqrt(max(mean, 0.0))
        return self.solved_error(self.skinning(model))

    def on_smaller(self, model: Model, error: float) -> None:
        s = self.skinning(model)
        rmse = error if self.problem.tolerance_of == "rmse" else self.solved_error.rmse(s)
        used = int(np.count_nonzero(s.weights))
        keys = np.full(s.n_bones, self.problem.n_frames)
        stored = bytes_of(
            s.n_vertices,
            used,
            self.problem.n_frames,
            keys,
            s.bone_model,
            key_bytes=key_bytes(s),
            tree=s.parents is not None,
        ).total
        self.smaller.append((model.n_bones, error, stored))
        self.record(rmse, "bones")

    # --- the two halves ------------------------------------------------------------------------

    def fewest_bones(self, start: Model | None) -> Skinning | None:
        """The search; where it saw a part of the frames, again until all of them hold."""
        search, effort = self.search, self.problem.effort
        skinning = None
        for _ in range(_RETRIES):
            search.run(start)
            if search.held is None:
                return skinning
            search.improve(_IMPROVE[effort])
            skinning = self.over_all_frames(search.held, passes=PASSES[effort], entering=ENTERING)
            if self.scan is None:
                return skinning
            if self.pending is not None:
                self.latest = skinning
                raise Stopped(self.pending)
            error = self.true_error(skinning)
            if error <= self.tolerance:
                return skinning
            search.lower_tolerance(0.99 * self.tolerance / error)
            start = None
        return skinning

    def fewest_bytes(self, skinning: Skinning, prunings: list[Pruning]) -> Skinning:
        """Fewer influences and keyframes, for what is left of the tolerance."""
        held = self.search.held
        assert held is not None
        first, last = self.smaller[0], self.smaller[-1]
        prunings.append(Pruning("bones", first[0], last[0], first[2], last[2], first[1], last[1]))
        error = self.true_error(skinning)
        if not error <= self.tolerance:
            return skinning
        budget = ErrorBudget(
            self.data,
            held,
            fixed=self.fixed,
            tolerance=self.tolerance,
            true_error=self.true_error,
            offsets=self.problem.offsets,
            streamed=self.scan is not None,
            to_skinning=lambda model: self.over_all_frames(model, passes=1, entering=0),
            on_try=lambda: self.search.report("pruning", 0.95),
        )
        fewer, keyed, losses = budget.spend(skinning, error)
        prunings.extend(losses)
        self.record(self.true_error.rmse(fewer), "influences")
        return keyed

    # --- models as skinnings -------------------------------------------------------------------

    def skinning(self, model: Model) -> Skinning:
        """A model of the frames that the search sees."""
        return self._named(model, self.data, model.tree)

    def over_all_frames(self, model: Model, *, passes: int, entering: int) -> Skinning:
        """A model of all frames, which are walked over where they were not in memory."""
        if self.scan is None:
            return self._named(model, self.data, hierarchy_of(self.problem, model, self.data))
        frames = AllFrames(
            self.problem.sequences,
            self.scan,
            self.data,
            model,
            fixed=self.fixed,
            prescribed=None,
            importance=self.problem.frame_importance,
            executor=self.executor,
        )
        last = math.inf
        for _ in range(passes):
            value = frames.pass_over(entering=entering, on_progress=self.on_progress)
            if self.pending is not None or not value < (1 - GAIN) * last:
                break
            last = value
        tree = hierarchy_of(self.problem, frames.model, frames.alignment)
        return self._named(frames.model, frames.alignment, tree)

    def _named(self, model: Model, alignment: Alignment, tree: Tree | None) -> Skinning:
        rest, transforms = alignment.to_world(model.rest, model.transforms)
        most = max(1, int((model.weights > 0).sum(axis=1).max()))
        padded = model.with_influences(self.problem.influences)
        indices, weights = padded.indices, padded.weights
        first, names = self.problem.sequences[0], names_of(self.problem.sequences)
        if len(transforms) != names["clips"][-1].stop:
            # Representative frames alone, of which no clip is whole.
            names = {"name": names["name"], "fps": names["fps"]}
        skinning = Skinning(
            rest,
            indices[:, :most],
            weights[:, :most],
            transforms,
            faces=first.faces,
            surface=first.surface,
            vertex_map=first.vertex_map,
            **names,
            bone_model=self.problem.fixed.bone_model,
        )
        return skinning if tree is None else with_tree(skinning, tree, alignment)

    # --- records and state ---------------------------------------------------------------------

    def record(self, rmse: float, phase: str) -> None:
        iteration, elapsed = self.search.iteration, self.clock.elapsed
        self.records.append(Record(iteration=iteration, elapsed=elapsed, rmse=rmse, phase=phase))

    def state(self) -> SolverState:
        search, records = self.search, self.records
        model = search.held or search.closest
        progress: dict[str, Any] = {
            "elapsed": self.clock.elapsed,
            "iteration": search.iteration,
            "rng": self.problem.rng.bit_generator.state,
        }
        return SolverState(
            settings=self.settings,
            progress=progress,
            history=np.array([[r.iteration, r.elapsed, r.rmse] for r in records]).reshape(-1, 3),
            phases=tuple(r.phase for r in records),
            current=model,
            best=search.held,
        )

    def restore(self, state: SolverState) -> Model | None:
        """Go on from a state; the model that it holds.

        Raises
        ------
        InputError
            If it is of another run, or damaged.
        """
        check_settings(state, self.settings)
        check_size(state.best, self.data.n_vertices, self.data.n_frames)
        with taking_up():
            self.clock.before = number(state.progress, "elapsed")
            self.search.iteration = whole(state.progress, "iteration")
            self.problem.rng.bit_generator.state = state.progress["rng"]
        return None if state.best is None else state.best.copy()

    def shortfall(self, skinning: Skinning, error: float, reason: str) -> str:
        """What a caller reads whose tolerance is not held."""

        def text(value: float) -> str:
            if not self.diagonal:
                return f"{value:.4g}"
            return f"{value:.4g} ({100 * value / self.diagonal:.3g} % of the diagonal)"

        kind = {"rmse": "RMSE", "max": "largest error"}[self.problem.tolerance_of]
        if reason == "tolerance out of reach":
            head = f"tolerance {text(self.asked)} is out of reach"
            if self.least > self.search.most:
                head += f", the motion's rank asks for at least {self.least} bones"
        else:
            head = f"stopped ({reason}) before tolerance {text(self.asked)} was held"
        most = self.problem.influences
        reached = f"{skinning.n_bones} bones of at most {most} influences reach a {kind} of"
        return f"{head}: {reached} {text(error)}"
