"""The fewest bones that hold a tolerance: a search that hands models on from try to try.

    rank bound -> grow until it holds -> merge down while it holds
         -> one bone less, tried ever harder, until no try holds it

A try is a :class:`~ssdr.search.run.Run` that may start from the model of another try
and ends as soon as it holds.
"""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Callable, Sequence

import numpy as np

from ..parallel import serial_blas
from ..search.problem import Given
from ..search.run import Run
from ..search.schedule import Op
from ..solver.alternation import bone_costs, vertex_step
from ..solver.model import Fixed, Model
from ..solver.trajectories import Trajectories
from .report import Attempt, Measure

__all__ = ["Search", "Stopped"]

_logger = logging.getLogger(__name__)
_OVERSHOOT = 4.0  # squared error, against the tolerance's, up to which merging guesses
_NEAR_RANK = 1.5  # below so many times the rank bound, a far miss may still be a bad minimum
_LEVEL_ROUNDS = 6
_EXPONENT = 1.3  # error falls about as bones to the power of minus this


@dataclasses.dataclass(frozen=True)
class _Zeal:
    """How hard a number of bones is tried before it is given up."""

    polish: int  # steps after merging down
    removals: int  # bones, cheapest first, whose removal is tried
    starts: tuple[float, ...]  # bones of new starts, relative to those tried
    reseeds: int
    rounds: int  # kicks out of a local minimum, each followed by a polish
    give_up: float  # times the tolerance beyond which no more is tried


_ZEAL = {
    "fast": _Zeal(6, 1, (), 6, 0, 1.1),
    "balanced": _Zeal(12, 3, (1.6, 2.2, 3.0), 24, 8, 1.3),
    "best": _Zeal(20, 6, (1.6, 2.2, 3.0, 1.3, 1.9, 2.6), 60, 30, 1.6),
}


class Stopped(Exception):
    """The caller, or a limit, ended the search; `reason` as in a decomposition."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class Search:
    """The search, which tells its steps and can be stopped between any two of them.

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
    step : callable
        Hears phase, iteration and an estimate of the share that is done after
        every step; what it returns, if not None, is the reason to stop.
    accept : callable
        Hears of every smaller model that holds, and its error.

    Attributes
    ----------
    held : Model or None
        The smallest model so far that holds.
    held_error : float
    closest : Model or None
        Where none holds, the one of least error.
    attempts : list of Attempt
    iteration : int
    """

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
        effort: str,
        rng: np.random.Generator,
        fixed: Fixed,
        given: Given,
        step: Callable[[str, int, float], str | None],
        accept: Callable[[Model, float], None],
    ) -> None:
        self.data, self.tolerance, self.measure, self.error = data, tolerance, measure, error
        self.least, self.most, self.influences = min(least, most), most, influences
        self.exact = exact
        self.zeal, self.rng, self.fixed, self.given = _ZEAL[effort], rng, fixed, given
        self.step, self.accept = step, accept
        self.held: Model | None = None
        self.held_error = math.inf
        self.closest: Model | None = None
        self.closest_error = math.inf
        self.attempts: list[Attempt] = []
        self.iteration = 0
        self.share = 0.0
        # the pooled error is at most the largest: what misses this misses either tolerance
        count = data.n_frames * data.n_vertices
        self.allowed = (tolerance / data.scale) ** 2 * count

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
        return self.held is not None and self.held.n_bones <= bones

    def _grow(self) -> None:
        """Models of ever more bones until one holds."""
        bones = self.least
        # so many bones are not passed over, and not given up lightly
        exact = self.exact if self.least < self.exact <= self.most else 0
        while True:
            last = bones in (exact, self.most)
            plan = [*self._begin(1.6), _reseed(6), _polish(24, 0.01)]
            model, error = self._try(bones, plan, None, "start", 0.0, 0.25)
            if last and self.held is None:
                self._insist(bones, model, error)
            if self.held is not None or bones >= self.most:
                return
            ratio = (error / self.tolerance) ** (1 / _EXPONENT) if self.tolerance > 0 else 2.0
            factor = min(max(1.2, 1.1 * ratio), 2.5)
            larger = max(bones + 1, math.ceil(bones * factor))
            bones = min(self.most, exact if bones < exact < larger else larger)

    def _shrink(self) -> None:
        """Between what failed and what holds: merged from what holds, insisted on when adjacent."""
        assert self.held is not None
        failed = [a.bones for a in self.attempts if a.bones < self.held.n_bones]
        low = max(failed, default=self.least - 1)
        while self.held.n_bones > self.least:
            held = self.held
            bones = min((low + held.n_bones) // 2, held.n_bones - self._guess(held))
            bones = max(bones, low + 1) if held.n_bones - low > 1 else low
            bones = max(bones, self.least)
            plan = [
                Op("merge", count=1000, amount=4, cost=20), Op("alternate", count=6),
                _polish(self.zeal.polish),
            ]  # fmt: skip
            wide = held.widened()
            model, error = self._try(bones, plan, wide, "merged", 0.25, 0.4)
            if not self.fits(bones):
                if held.n_bones - bones > 1:
                    low = bones
                    continue
                self._insist(bones, model, error)
                if not self.fits(bones):
                    return
            if self.held.n_bones <= low + 1:
                # what failed before was not tried as hard
                low = max(self.least - 1, self.held.n_bones - 1 - self._guess(self.held))

    def _guess(self, model: Model) -> int:
        """Bones whose joint removal may still hold after a polish, by what each would cost."""
        wide = model.widened()
        cost = np.sort(bone_costs(self.data, wide))
        now = model.objective(self.data)
        limit = _OVERSHOOT * self.allowed if self.measure == "rmse" else 2.0 * now
        room = limit - now
        return max(1, int(np.searchsorted(np.cumsum(cost), room)))

    def _insist(self, bones: int, model: Model, error: float) -> None:
        """All that is tried before a number of bones is given up."""
        zeal = self.zeal
        wider = self.held
        best, least = model, error
        work: list[tuple[str, list[Op], Model | None]] = []
        if zeal.reseeds:
            work.append(("re-seeded", [Op("recall"), _reseed(8), _polish(zeal.polish)], model))
        if wider is not None and wider.n_bones == bones + 1:
            wide = wider.widened()
            order = np.argsort(bone_costs(self.data, wide), kind="stable")
            for bone in order[1 : zeal.removals]:
                smaller = wide.without(np.array([bone]))
                vertex_step(self.data, smaller, fixed=self.fixed)
                work.append(
                    ("another bone removed",
                     [Op("alternate", count=8), _polish(zeal.polish)], smaller)
                )  # fmt: skip
        for factor in zeal.starts:
            work.append(("new start", [*self._begin(factor), _polish(8)], None))
        for k, (start, plan, begin) in enumerate(work):
            low = 0.4 + 0.3 * k / len(work)
            found, reached = self._try(bones, plan, begin, start, low, low + 0.3 / len(work))
            if reached < least:
                best, least = found, reached
            if self.fits(bones):
                return
            if start == "new start" and self._hopeless(bones, least):
                return
        if zeal.rounds == 0 or self._hopeless(bones, least):
            return
        plan = [
            Op("recall"), _reseed(zeal.reseeds), _polish(30),
            Op("recall"), Op("search", count=zeal.rounds, patience=zeal.rounds, cost=60),
        ]  # fmt: skip
        self._try(bones, plan, best, "kicked", 0.7, 0.9)

    def _hopeless(self, bones: int, error: float) -> bool:
        # exact skinning has no slope that tells how far there is to go
        near = self.exact > 0 or (self.least > 1 and bones < _NEAR_RANK * self.least + 1)
        return not near and error > self.zeal.give_up * self.tolerance

    def _begin(self, factor: float) -> list[Op]:
        return [
            Op("start", amount=factor, cost=8), Op("alternate", count=10),
            Op("merge", count=1000, amount=4, cost=20), Op("alternate", count=6),
        ]  # fmt: skip

    def _try(
        self,
        bones: int,
        plan: Sequence[Op],
        start: Model | None,
        name: str,
        low: float,
        high: float,
    ) -> tuple[Model, float]:
        """Walk through a plan until it holds; the model of `bones` bones and its error."""
        run = Run(
            self.data, list(plan), bones=bones, influences=self.influences,
            rng=self.rng, fixed=self.fixed, given=self.given, smooth=None,
        )  # fmt: skip
        if start is not None:
            run.model = start.copy()
            if start.n_bones == bones:
                run.best, run.best_value = start.copy(), start.objective(self.data)
        seen = 0
        checked = math.inf
        # checking costs about as much as a step
        worth = 1.0 if self.measure == "rmse" else 0.97
        error = math.inf
        with serial_blas():
            while not run.finished:
                phase = run.phase
                run.advance()
                self.iteration += run.iteration - seen
                seen = run.iteration
                self.share = max(self.share, low + (high - low) * run.fraction)
                if run.best is not None and run.best_value <= min(
                    self.allowed * (1 + 1e-9), worth * checked
                ):
                    checked = run.best_value
                    error = self.error(run.best)
                    if error <= self.tolerance:
                        break
                self.tell(f"{_bones(bones)}: {phase}", self.share, run.best, name)
        assert run.best is not None
        model = run.best
        if not error <= self.tolerance:
            error = self.error(model)
            if self.measure == "max" and self.tolerance < error <= 2.0 * self.tolerance:
                model, error = self._level(model, error)
        self._record(model, error, seen, name)
        return model, error

    def _level(self, model: Model, error: float) -> tuple[Model, float]:
        """Lower the largest error: vertices count more the larger their share of it (Lawson)."""
        best, least = model, error
        importance = self.data.importance
        current = model
        for _ in range(_LEVEL_ROUNDS):
            size = np.sqrt(np.maximum(current.error, 0.0))
            importance = importance * (0.05 + size / max(float(size.max()), 1e-300))
            importance = importance / importance.mean()
            data = dataclasses.replace(self.data, importance=importance)
            run = Run(
                data, [Op("recall"), Op("alternate", count=2), _polish(4, 0.0)],
                bones=model.n_bones, influences=model.n_influences, rng=self.rng,
                fixed=self.fixed, given=self.given, smooth=None,
            )  # fmt: skip
            run.best, run.best_value = current.copy(), current.objective(data)
            while not run.finished:
                run.advance()
            self.iteration += run.iteration
            assert run.best is not None
            current = run.best
            reached = self.error(current)
            if reached < least:
                best, least = current, reached
            self.tell(f"{_bones(model.n_bones)}: level", self.share, best, "level")
            if least <= self.tolerance:
                break
        return best, least

    def tell(self, phase: str, share: float, model: Model | None = None, name: str = "") -> None:
        """Report a step; :class:`Stopped` if that is to be the last one.

        `model` is what the step has, kept where nothing else is there to hand out.
        """
        self.share = max(self.share, share)
        reason = self.step(phase, self.iteration, self.share)
        if reason is None:
            return
        if self.held is None and self.closest is None and model is not None:
            self._record(model, self.error(model), 0, name)
        if reason == "cancelled" or self.held is not None or self.closest is not None:
            raise Stopped(reason)

    def tighten(self, factor: float) -> None:
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
                self.accept(model, error)
        elif error < self.closest_error:
            self.closest, self.closest_error = model, error

    def improve(self, steps: int) -> None:
        """Polish the model that holds: what it gains is room for pruning."""
        if self.held is None:
            return
        held, error = self.held, self.held_error
        run = Run(
            self.data, [_polish(steps)], bones=held.n_bones, influences=held.n_influences,
            rng=self.rng, fixed=self.fixed, given=self.given, smooth=None,
        )  # fmt: skip
        run.model = held.copy()
        run.best, run.best_value = held.copy(), held.objective(self.data)
        seen = 0
        with serial_blas():
            while not run.finished:
                run.advance()
                self.iteration += run.iteration - seen
                seen = run.iteration
                self.tell(f"{_bones(held.n_bones)}: polish", max(self.share, 0.9))
        assert run.best is not None
        reached = self.error(run.best)
        if reached < error:
            self.held, self.held_error = run.best, reached


def _polish(count: int, tolerance: float = 0.005) -> Op:
    return Op("polish", count=count, tolerance=tolerance, cost=6)


def _reseed(count: int) -> Op:
    return Op("reseed", count=count, amount=4, patience=max(4, count // 5), cost=6)


def _bones(count: int) -> str:
    return "1 bone" if count == 1 else f"{count} bones"
