"""Stages of a schedule for bones without joints.

The `apply` of a stage is a generator that yields after each step.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np

from ..solver.alternation import bone_step, vertex_step
from ..solver.gauge import normalise_gauge
from ..solver.gauss_newton import GaussNewton
from ..solver.model import Locked, Model
from ..solver.trajectories import Trajectories
from .moves import (
    add_and_merge_bones,
    alternate_some,
    entering_at,
    exchange_bones,
    exchange_influences,
    merge_bones,
    move_cheapest_bone,
    polish_steps,
    polish_then_drop_influence,
)
from .run import Run, Stage

__all__ = [
    "STEPS_OF_A_TRIAL",
    "AddAndMerge",
    "Alternate",
    "Change",
    "Compress",
    "Merge",
    "MoveBones",
    "Polish",
    "Relax",
    "Search",
]

# An alternation that gains less than this, relative to the objective, does not count.
_PLATEAU = 1e-5
_PLATEAU_ALTERNATIONS = 3  # in a row: fewer end on a pause that is followed by progress
_POLISH_WINDOW = 8  # polish steps over which the stopping test looks
STEPS_OF_A_TRIAL = 8  # polish steps before a trial of a search is judged
_CLOSE = 1.02  # ratio of objectives below which a trial gets as many polish steps again
_MOST_MISSES = 8  # failures that count against a kind of change: none is given up for good

# makes a changed copy of a model
Change = Callable[[Trajectories, Model, np.random.Generator, Locked], Model]


# --- steps on all bones ------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, kw_only=True)
class Compress(Stage):
    """Write the frames as the fewest combinations of frames that hold what matters."""

    phase: ClassVar[str] = "compress"
    cost: float = 4

    def apply(self, run: Run) -> Iterator[None]:
        run.compress()
        yield


@dataclasses.dataclass(frozen=True, kw_only=True)
class Alternate(Stage):
    """Bones, then weights and rest pose: the alternation of Le and Deng.

    Attributes
    ----------
    gain : float
        Relative decrease of the objective that an alternation has to bring; three in a row that
        bring less end the stage.
    """

    phase: ClassVar[str] = "alternate"
    gain: float = _PLATEAU

    def apply(self, run: Run) -> Iterator[None]:
        failures = 0
        for _ in range(self.steps):
            model, data = run.present, run.data
            before = run.value(model)
            bone_step(data, model, locked=run.locked)
            pull = stiff = None
            if run.smoothness is not None:
                pull, stiff = run.smoothness.terms(model)
            vertex_step(data, model, locked=run.locked, pull=pull, stiff=stiff)
            normalise_gauge(model, data.importance, run.locked)
            run.iteration += 1
            still = before - run.value(model) < max(self.gain, _PLATEAU) * before
            failures = failures + 1 if still else 0
            run.converged = failures >= _PLATEAU_ALTERNATIONS
            yield
            if run.converged:
                return


@dataclasses.dataclass(frozen=True, kw_only=True)
class Relax(Stage):
    """More influences than asked for, at most twice as many; each step gives up one.

    Attributes
    ----------
    steps : int
        Influences more, at most.  A vertex of the polish costs (K + 2)² numbers.
    polish_steps : int
        At each number of influences.
    """

    phase: ClassVar[str] = "relax"
    steps: int = 4
    cost: float = 40
    polish_steps: int = 8

    def apply(self, run: Run) -> Iterator[None]:
        k = run.influences
        model = run.present
        model = model.with_influences(min(2 * k, k + self.steps, model.n_bones))
        for _ in range(max(1, model.n_influences - k)):
            if model.n_influences > k:
                model = polish_then_drop_influence(
                    run.data, model, run.locked, steps=self.polish_steps
                )
                run.iteration += self.polish_steps
            run.model = model
            yield
            model = run.present


@dataclasses.dataclass(frozen=True, kw_only=True)
class Polish(Stage):
    """Variable-projection Gauss–Newton steps of all bones together.

    Attributes
    ----------
    gain : float
        Relative decrease of the error, over eight steps, below which the stage ends.
    """

    phase: ClassVar[str] = "polish"
    cost: float = 6
    gain: float = 0.0

    def apply(self, run: Run) -> Iterator[None]:
        polish = GaussNewton(run.data, run.present, locked=run.locked)
        values = [polish.value]
        for k in range(self.steps):
            polish.step(entering=entering_at(k))
            run.iteration += 1
            values = [*values, polish.value][-_POLISH_WINDOW - 1 :]
            # the objective is a square: its relative change is twice that of the error
            gain = 0.5 * (values[0] - values[-1]) / max(values[0], 1e-300)
            run.converged = len(values) > _POLISH_WINDOW and gain < self.gain
            yield
            if run.converged:
                return


# --- changes -----------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, kw_only=True)
class Merge(Stage):
    """Remove the cheapest third of the excess bones, alternate, and again until none is left.

    Attributes
    ----------
    alternations : int
        After each removal.
    """

    phase: ClassVar[str] = "merge"
    steps: int = 3  # expected: thirds of 0.6 excess bones for each asked for
    cost: float = 20
    alternations: int = 4

    def apply(self, run: Run) -> Iterator[None]:
        while run.present.n_bones > run.bones:
            run.model = merge_bones(run.data, run.present, run.bones, self.alternations, run.locked)
            run.iteration += self.alternations
            yield


@dataclasses.dataclass(frozen=True, kw_only=True)
class MoveBones(Stage):
    """Move one of the cheapest bones to where the error is; keep what is better.

    Attributes
    ----------
    alternations : int
        Before the move is judged.
    patience : int
        Failures in a row that end the stage.
    """

    phase: ClassVar[str] = "move bones"
    steps: int = 16
    cost: float = 6
    alternations: int = 4
    patience: int = 4

    def apply(self, run: Run) -> Iterator[None]:
        failures = 0
        for _ in range(self.steps):
            trial = self.trial(run)
            run.iteration += self.alternations
            if trial is None:
                yield
                return
            failures = 0 if run.accept_if_lower(trial) else failures + 1
            yield
            if failures >= self.patience:
                return

    def trial(self, run: Run) -> Model | None:
        """A changed copy; None if nothing can change."""
        return move_cheapest_bone(run.data, run.present, run.rng, self.alternations, run.locked)


@dataclasses.dataclass(frozen=True, kw_only=True)
class AddAndMerge(MoveBones):
    """Add several bones where the error is, and merge them down again.

    Attributes
    ----------
    patience : int
        Failures in a row that end the stage.  0: one step whose result is taken in any case,
        since what it is worth shows only once it has been relaxed and searched.
    """

    phase: ClassVar[str] = "add and merge"
    steps: int = 1
    cost: float = 20
    alternations: int = 3
    patience: int = 0

    def apply(self, run: Run) -> Iterator[None]:
        if self.patience:
            yield from super().apply(run)
            return
        run.model = self.trial(run)
        run.iteration += self.alternations
        yield

    def trial(self, run: Run) -> Model:
        return add_and_merge_bones(run.data, run.present, run.rng, self.alternations, run.locked)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Search(Stage):
    """Change the model in one of several ways, polish, and keep what is better.

    Attributes
    ----------
    patience : int
        Trials in a row without success that end the stage.
    gain : float
        Relative decrease of the objective that makes a trial a success.
    """

    phase: ClassVar[str] = "search"
    changes: ClassVar[tuple[Change, ...]] = (exchange_bones, alternate_some, exchange_influences)
    cost: float = 60
    patience: int
    gain: float = 1e-3

    def apply(self, run: Run) -> Iterator[None]:
        last_turn = list(range(-len(self.changes), 0))
        misses = [0] * len(self.changes)
        failures = 0
        for k in range(self.steps):
            base = run.value(run.present)
            # The change whose wait, divided by 1 + its recent failures, is the longest: by turns
            # while all pay.  Which ones do differs between sequences, and between early and late.
            waits = [(k - t) / (1 + m) for t, m in zip(last_turn, misses, strict=True)]
            kind = int(np.argmax(waits))
            trial = self.changes[kind](run.data, run.present, run.rng, run.locked)
            value = self.polished_value(run, trial, base)
            run.iteration += STEPS_OF_A_TRIAL
            if value < base:
                run.model = trial
            success = value < (1.0 - self.gain) * base
            failures = 0 if success else failures + 1
            last_turn[kind] = k
            misses[kind] = 0 if success else min(misses[kind] + 1, _MOST_MISSES)
            run.converged = failures >= self.patience
            yield
            if run.converged:
                return

    def polished_value(self, run: Run, trial: Model, base: float) -> float:
        """Polish a trial (in place) before it is judged; its objective."""
        polish_steps(run.data, trial, STEPS_OF_A_TRIAL, run.locked)
        value = run.value(trial)
        if base <= value < _CLOSE * base:
            polish_steps(run.data, trial, STEPS_OF_A_TRIAL, run.locked)
            value = run.value(trial)
        return value
