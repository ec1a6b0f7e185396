"""The fewest bones that hold a tolerance: a search that hands models on from try to try.

    rank bound -> grow until it holds -> merge down while it holds
         -> one bone less, tried ever harder, until no try holds it

A try is a :class:`~ssdr.search.run.Run` that may start from the model of another try
and ends as soon as it holds the tolerance.
"""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Callable

import numpy as np

from ..checks import LARGEST
from ..drivers.problem import Measure
from ..drivers.schedule import Effort, Schedule, merged_start
from ..search.prescribed import Prescribed
from ..search.run import Run
from ..search.sampling import Recall
from ..search.stages import Alternate, Merge, Polish, Reseed, Search
from ..solver.alternation import bone_costs, vertex_step
from ..solver.model import Fixed, Model
from ..solver.trajectories import Array, Trajectories
from .report import Attempt

__all__ = ["FewestBones", "Stopped", "polish_stage"]

_logger = logging.getLogger(__name__)
_OVERSHOOT = 4.0  # squared error, against the tolerance's, up to which merging guesses
_NEAR_RANK = 1.5  # below so many times the rank bound, a far miss may still be a bad minimum
# Rounds of Lawson's reweighting, and the importance that a vertex without error keeps in each.
_LEVEL_ROUNDS, _LEVEL_FLOOR = 6, 0.05
_EXPONENT = 1.3  # error falls about as bones to the power of minus this
# A next number of bones, relative to the one that failed: beyond the guess by that exponent, lest
# the next fails by a little, and within these bounds.
_BEYOND_GUESS, _LEAST_GROWTH, _MOST_GROWTH = 1.1, 1.2, 2.5


@dataclasses.dataclass(frozen=True)
class _Tries:
    """What is tried for a number of bones before it is given up."""

    polish: int  # steps after merging down
    removals: int  # bones, cheapest first, whose removal is tried
    starts: tuple[float, ...]  # bones of new starts, relative to those tried
    reseeds: int
    rounds: int  # kicks out of a local minimum, each followed by a polish
    give_up: float  # times the tolerance beyond which no more is tried


_TRIES = {
    "fast": _Tries(6, 1, (), 6, 0, 1.1),
    "balanced": _Tries(12, 3, (1.6, 2.2, 3.0), 24, 8, 1.3),
    "best": _Tries(20, 6, (1.6, 2.2, 3.0, 1.3, 1.9, 2.6), 60, 30, 1.6),
}


class Stopped(Exception):
    """The caller, or a limit, ended the search; `reason` as in a decomposition."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class FewestBones:
    """The search, which reports its steps and can be stopped between any two of them.

    Parameters
    ----------
    data : Trajectories
    tolerance : float
        In units of `error`.
    error : callable
        The error of a model, as the tolerance means it.
    least, most : int
        Bounds on the number of bones; `least` is a proven one.
    exact : int
        Where the motion's rank ends it may be exact skinning, by at most so many
        bones if they hang together by joints; 0 where that is far above `least`.
    effort : {"fast", "balanced", "best"}
    on_step : callable
        Called with phase, iteration and an estimate of the fraction that is done
        after every step; what it returns, if not None, is the reason to stop.
    on_smaller : callable
        Called with every smaller model that holds the tolerance, and its error.

    Attributes
    ----------
    held : Model or None
        The smallest model so far that holds the tolerance.
    held_error : float
    closest : Model or None
        Where none holds it, the one of least error.
    attempts : list of Attempt
    iteration : int
    """

    rigid_joints = False

    def __init__(
        self,
        data: Trajectories,
        *,
        tolerance: float,
        measure: Measure,
        error: Callable[[Model], float],
        least: int,
        most: int,
        exact: int,
        influences: int,
        effort: Effort,
        rng: np.random.Generator,
        fixed: Fixed,
        prescribed: Prescribed,
        on_step: Callable[[str, int, float], str | None],
        on_smaller: Callable[[Model, float], None],
    ) -> None:
        self.data, self.tolerance, self.measure, self.error = data, tolerance, measure, error
        self.least, self.most, self.influences = min(least, most), most, influences
        self.exact = exact
        self.tries, self.rng, self.fixed, self.prescribed = _TRIES[effort], rng, fixed, prescribed
        self.on_step, self.on_smaller = on_step, on_smaller
        self.held: Model | None = None
        self.held_error = math.inf
        self.closest: Model | None = None
        self.closest_error = math.inf
        self.attempts: list[Attempt] = []
        self.iteration = 0
        self.fraction = 0.0
        # the pooled error is at most the largest: what misses this misses either tolerance
        count = data.n_frames * data.n_vertices
        self.allowed = min(tolerance / data.scale, LARGEST) ** 2 * count

    def run(self, start: Model | None = None) -> None:
        """Find the fewest bones, from a model of another search where there is one."""
        if start is not None and start.n_bones <= self.most:
            error = self.error(start)
            self._record(start, error, 0, "resumed")
        if self.held is None:
            self._grow()
        if self.held is not None:
            self._shrink()

    def fits(self, bones: int) -> bool:
        """Whether a model of at most so many bones holds the tolerance."""
        return self.held is not None and self.held.n_bones <= bones

    def _grow(self) -> None:
        """Models of ever more bones until one holds the tolerance."""
        bones = self.least
        # so many bones are not passed over, and not given up lightly
        exact = self.exact if self.least < self.exact <= self.most else 0
        while True:
            last = bones in (exact, self.most)
            schedule = (*self._begin(1.6), *self._settle())
            model, error = self._try(bones, schedule, None, "start", 0.0, 0.25)
            if last and self.held is None:
                self._insist(bones, model, error)
            if self.held is not None or bones >= self.most:
                return
            ratio = (error / self.tolerance) ** (1 / _EXPONENT) if self.tolerance > 0 else 2.0
            factor = min(max(_LEAST_GROWTH, _BEYOND_GUESS * ratio), _MOST_GROWTH)
            larger = max(bones + 1, math.ceil(bones * factor))
            bones = min(self.most, exact if bones < exact < larger else larger)

    def _shrink(self) -> None:
        """Between what failed and what holds: merge from what holds, insist when they touch."""
        assert self.held is not None
        failed = [a.bones for a in self.attempts if a.bones < self.held.n_bones]
        low = max(failed, default=self.least - 1)
        while self.held.n_bones > self.least:
            held = self.held
            bones = min((low + held.n_bones) // 2, held.n_bones - self._removable(held))
            bones = max(bones, low + 1) if held.n_bones - low > 1 else low
            bones = max(bones, self.least)
            schedule = (*self._merge(), polish_stage(self.tries.polish))
            wide = held.with_restarted_support()
            model, error = self._try(bones, schedule, wide, "merged", 0.25, 0.4)
            if not self.fits(bones):
                if held.n_bones - bones > 1:
                    low = bones
                    continue
                self._insist(bones, model, error)
                if not self.fits(bones):
                    return
            if self.held.n_bones <= low + 1:
                # what failed before was not tried as hard
                low = max(self.least - 1, self.held.n_bones - 1 - self._removable(self.held))

    def _removable(self, model: Model) -> int:
        """Bones whose joint removal may be made up for by a polish, by what each would cost."""
        cost = np.sort(self._costs(model.with_restarted_support()))
        now = model.weighted_error(self.data)
        limit = _OVERSHOOT * self.allowed if self.measure == "rmse" else 2.0 * now
        return max(1, int(np.searchsorted(np.cumsum(cost), limit - now)))

    def _insist(self, bones: int, model: Model, error: float) -> None:
        """All that is tried before a number of bones is given up."""
        tries = self.tries
        best, least = model, error
        work = self._other_starts(bones, model)
        for k, (name, schedule, start) in enumerate(work):
            low = 0.4 + 0.3 * k / len(work)
            trial, reached = self._try(bones, schedule, start, name, low, low + 0.3 / len(work))
            if reached < least:
                best, least = trial, reached
            if self.fits(bones):
                return
            if name == "new start" and self._hopeless(bones, least):
                return
        if tries.rounds == 0 or self._hopeless(bones, least):
            return
        self._try(bones, self._insisting(), best, "kicked", 0.7, 0.9)

    # --- what a subclass does otherwise --------------------------------------------------------

    def _begin(self, factor: float) -> Schedule:
        """A first model of the bones asked for, from `factor` times as many."""
        return merged_start(factor, 10, 6)

    def _settle(self) -> Schedule:
        return (_reseed(6), Polish(steps=24, gain=0.01))

    def _merge(self) -> Schedule:
        """From a model of more bones down to those asked for."""
        return (Merge(), Alternate(steps=6))

    def _costs(self, model: Model) -> Array:
        """What the objective grows by where each bone goes, (B,)."""
        return bone_costs(self.data, model)

    def _insisting(self) -> Schedule:
        """The last and longest try."""
        rounds = self.tries.rounds
        return (
            Recall(),
            _reseed(self.tries.reseeds),
            polish_stage(30),
            Recall(),
            Search(steps=rounds, patience=rounds, gain=0.0),
        )

    def _other_starts(self, bones: int, model: Model) -> list[tuple[str, Schedule, Model | None]]:
        """Name, schedule and first model of each."""
        tries, wider = self.tries, self.held
        work: list[tuple[str, Schedule, Model | None]] = []
        if tries.reseeds:
            schedule: Schedule = (Recall(), _reseed(8), polish_stage(tries.polish))
            work.append(("re-seeded", schedule, model))
        if wider is not None and wider.n_bones == bones + 1:
            wide = wider.with_restarted_support()
            order = np.argsort(bone_costs(self.data, wide), kind="stable")
            # without the cheapest bone: merging down has tried that
            for bone in order[1 : tries.removals]:
                smaller = wide.without(np.array([bone]))
                vertex_step(self.data, smaller, fixed=self.fixed)
                schedule = (Alternate(steps=8), polish_stage(tries.polish))
                work.append(("another bone removed", schedule, smaller))
        for factor in tries.starts:
            work.append(("new start", (*self._begin(factor), polish_stage(8)), None))
        return work

    def _hopeless(self, bones: int, error: float) -> bool:
        # exact skinning has no slope that says how far there is to go
        near = self.exact > 0 or (self.least > 1 and bones < _NEAR_RANK * self.least + 1)
        return not near and error > self.tries.give_up * self.tolerance

    def _try(
        self,
        bones: int,
        schedule: Schedule,
        start: Model | None,
        name: str,
        low: float,
        high: float,
    ) -> tuple[Model, float]:
        """A run that ends as soon as it holds; the model of `bones` bones and its error."""
        run = self._new_run(self.data, schedule, bones, self.influences)
        if start is not None:
            run.begin_with(start)
        iteration = 0
        checked = error = math.inf
        # checking costs about as much as a step
        worth_checking = 1.0 if self.measure == "rmse" else 0.97

        def after_step(phase: str) -> str | None:
            nonlocal iteration, checked, error
            self.iteration += run.iteration - iteration
            iteration = run.iteration
            self.fraction = max(self.fraction, low + (high - low) * run.fraction)
            if run.best is not None and run.best_value <= min(
                self.allowed * (1 + 1e-9), worth_checking * checked
            ):
                checked = run.best_value
                error = self.error(run.best)
                if error <= self.tolerance:
                    return "held"
            self.report(f"{_bones(bones)}: {phase}", self.fraction, run.best, name)
            return None

        run.drive(after_step)
        model = run.best_model
        if not error <= self.tolerance:
            error = self.error(model)
            if self.measure == "max" and self.tolerance < error <= 2.0 * self.tolerance:
                model, error = self._level(model, error)
        self._record(model, error, iteration, name)
        return model, error

    def _level(self, model: Model, error: float) -> tuple[Model, float]:
        """Lower the largest error: vertices count more the larger their part of it (Lawson)."""
        best, least = model, error
        importance = self.data.importance
        current = model
        for _ in range(_LEVEL_ROUNDS):
            size = np.sqrt(np.maximum(current.error, 0.0))
            importance = importance * (_LEVEL_FLOOR + size / max(float(size.max()), 1e-300))
            importance = importance / importance.mean()
            data = dataclasses.replace(self.data, importance=importance)
            first = () if self.rigid_joints else (Alternate(steps=2),)
            schedule = (Recall(), *first, Polish(steps=4))
            run = self._new_run(data, schedule, model.n_bones, model.n_influences)
            run.best, run.best_value = current.copy(), current.weighted_error(data)
            run.drive()
            self.iteration += run.iteration
            current = run.best_model
            reached = self.error(current)
            if reached < least:
                best, least = current, reached
            self.report(f"{_bones(model.n_bones)}: level", self.fraction, best, "level")
            if least <= self.tolerance:
                break
        return best, least

    def _new_run(self, data: Trajectories, schedule: Schedule, bones: int, influences: int) -> Run:
        return Run(
            data,
            schedule,
            bones=bones,
            influences=influences,
            rng=self.rng,
            fixed=self.fixed,
            prescribed=self.prescribed,
            rigid_joints=self.rigid_joints,
        )

    def report(
        self, phase: str, fraction: float, model: Model | None = None, name: str = ""
    ) -> None:
        """Report a step; :class:`Stopped` if that is to be the last one.

        `model` is what the step has, kept where nothing else is there to hand out.
        """
        self.fraction = max(self.fraction, fraction)
        reason = self.on_step(phase, self.iteration, self.fraction)
        if reason is None:
            return
        if self.held is None and self.closest is None and model is not None:
            self._record(model, self.error(model), 0, name)
        if reason == "cancelled" or self.held is not None or self.closest is not None:
            raise Stopped(reason)

    def lower_tolerance(self, factor: float) -> None:
        """Ask for less error, of at least as many bones as hold now."""
        assert self.held is not None
        self.tolerance *= factor
        self.allowed *= factor**2
        self.least = self.held.n_bones
        if self.held_error > self.tolerance:
            self.closest, self.closest_error = self.held, self.held_error
            self.held, self.held_error = None, math.inf

    def _record(self, model: Model, error: float, iterations: int, name: str) -> None:
        self.attempts.append(Attempt(model.n_bones, error, iterations, name))
        _logger.debug("%d bones, %s: %.6g of %.6g", model.n_bones, name, error, self.tolerance)
        if error <= self.tolerance:
            if self.held is None or model.n_bones < self.held.n_bones:
                self.held, self.held_error = model, error
                self.on_smaller(model, error)
        elif error < self.closest_error:
            self.closest, self.closest_error = model, error

    def improve(self, steps: int) -> None:
        """Polish the model that holds: what it gains is error budget for pruning."""
        if self.held is None:
            return
        held, error = self.held, self.held_error
        run = self._new_run(self.data, (polish_stage(steps),), held.n_bones, held.n_influences)
        run.begin_with(held)
        iteration = 0

        def after_step(_: str) -> None:
            nonlocal iteration
            self.iteration += run.iteration - iteration
            iteration = run.iteration
            self.report(f"{_bones(held.n_bones)}: polish", max(self.fraction, 0.9))

        run.drive(after_step)
        reached = self.error(run.best_model)
        if reached < error:
            self.held, self.held_error = run.best_model, reached


def polish_stage(steps: int) -> Polish:
    """Until it hardly gains."""
    return Polish(steps=steps, gain=0.005)


def _reseed(steps: int) -> Reseed:
    return Reseed(steps=steps, patience=max(4, steps // 5))


def _bones(count: int) -> str:
    return "1 bone" if count == 1 else f"{count} bones"
