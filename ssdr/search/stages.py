"""Stages of a schedule for bones without joints.

The method `apply` of a stage is a generator that yields after each step.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np

from ..solver.alternation import bone_step, vertex_step
from ..solver.gauge import free_gauge
from ..solver.gauss_newton import GaussNewton
from ..solver.model import Locked, Model
from ..solver.objective import normal_length
from ..solver.trajectories import Trajectories
from ..solver.vertex_newton import optimise_some
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
    "SolveNormals",
    "Unfold",
]

# Relative decrease of the objective below which an alternation counts as a failure.
_PLATEAU = 1e-5
# Failures in a row that end the stage: with fewer, it would end at a pause in the progress.
_PLATEAU_ALTERNATIONS = 3
_POLISH_WINDOW = 8  # polish steps over which the stopping test measures the gain
STEPS_OF_A_TRIAL = 8  # polish steps before a trial of a search is judged
# Ratio of a trial's objective to the present one below which the trial is polished once more.
_CLOSE = 1.02
# Most failures that count against a kind of change, so that none is given up for good.
_MOST_MISSES = 8

# A function that returns a changed copy of a model.
Change = Callable[[Trajectories, Model, np.random.Generator, Locked], Model]


# --- steps on all bones ------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, kw_only=True)
class Compress(Stage):
    """Compress the trajectories to few columns, so that later steps take less time."""

    phase: ClassVar[str] = "compress"
    cost: float = 4

    def apply(self, run: Run) -> Iterator[None]:
        run.compress()
        yield


@dataclasses.dataclass(frozen=True, kw_only=True)
class Alternate(Stage):
    """Alternation of Le and Deng: solve the bones, then the weights and the rest pose.

    Attributes
    ----------
    gain : float
        Relative decrease of the objective that is expected of an alternation; three alternations in
        a row with less end the stage.
    """

    phase: ClassVar[str] = "alternate"
    gain: float = _PLATEAU

    def apply(self, run: Run) -> Iterator[None]:
        failures = 0
        for _ in range(self.steps):
            model, data = run.present, run.data
            before = run.value(model)
            penalty, pull, stiff = 0.0, None, None
            if run.smoothness is not None:
                penalty = run.smoothness.penalty(model)
                pull, stiff = run.smoothness.terms(model)
            bone_step(data, model, locked=run.locked, length=normal_length(data, model, penalty))
            vertex_step(data, model, locked=run.locked, pull=pull, stiff=stiff, penalty=penalty)
            free_gauge(data, model, run.locked)
            run.iteration += 1
            still = before - run.value(model) < max(self.gain, _PLATEAU) * before
            failures = failures + 1 if still else 0
            run.converged = failures >= _PLATEAU_ALTERNATIONS
            yield
            if run.converged:
                return


@dataclasses.dataclass(frozen=True, kw_only=True)
class Relax(Stage):
    """Polish with up to twice the influences asked for, and give up one per vertex at each step.

    Attributes
    ----------
    steps : int
        Most influences beyond those asked for.  More would take much memory, since a polish holds
        (K + 2)² numbers per vertex for K influences.
    polish_steps : int
        Number of polish steps at each number of influences.
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
    """Improve all bones together by Gauss–Newton steps with variable projection.

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


@dataclasses.dataclass(frozen=True, kw_only=True)
class SolveNormals(Stage):
    """Solve rest normals as well from now on, unless the mesh has no triangles or bones stretch.

    It comes late, since normals lead a search for places of bones to models with more error.
    """

    phase: ClassVar[str] = "normals"
    cost: float = 4

    def apply(self, run: Run) -> Iterator[None]:
        if len(run.whole.faces) and run.asked.bone_model == "rigid":
            run.solve_normals()
        yield


@dataclasses.dataclass(frozen=True, kw_only=True)
class Unfold(Stage):
    """Turn triangles of the rest pose back that are turned over, by stiffer edges around them.

    It makes the best model the one that a run returns, as a rest pose with folds is no surface.

    Attributes
    ----------
    rounds : int
        Solves of weights and rest pose after the edges have become stiffer.
    """

    phase: ClassVar[str] = "unfold"
    steps: int = 8
    cost: float = 3
    rounds: int = 4

    def apply(self, run: Run) -> Iterator[None]:
        if run.whole.surface is None:
            return
        run.model, locked = run.best_model.with_restarted_support(), run.locked
        if run.smoothness is not None:  # which this solve of weights would not know
            every = np.ones(run.whole.n_vertices, dtype=bool)
            locked = dataclasses.replace(locked, weights=every)
        for _ in range(self.steps):
            turned = run.whole.surface.turned(run.model.rest, run.whole.faces)
            if not turned.any():
                return
            run.stiffen(run.whole.faces[turned])
            # far from the stiffer edges nothing has changed
            near = run.whole.surface.around(run.whole.faces[turned])
            optimise_some(run.data, run.model, near, locked=locked, times=self.rounds)
            run.keep_present()
            yield


# --- changes -----------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, kw_only=True)
class Merge(Stage):
    """Remove excess bones, in each step the cheapest third of the excess, and alternate.

    The cheapest bones are those whose removal raises the objective least.

    Attributes
    ----------
    alternations : int
        Number of alternations after each removal.
    """

    phase: ClassVar[str] = "merge"
    steps: int = 3  # expected number, for 0.6 excess bones per bone asked for
    cost: float = 20
    alternations: int = 4

    def apply(self, run: Run) -> Iterator[None]:
        while run.present.n_bones > run.bones:
            run.model = merge_bones(run.data, run.present, run.bones, self.alternations, run.locked)
            run.iteration += self.alternations
            yield


@dataclasses.dataclass(frozen=True, kw_only=True)
class MoveBones(Stage):
    """Move one of the cheapest bones to where the error is largest; keep the better model.

    The cheapest bones are those whose removal raises the objective least.

    Attributes
    ----------
    alternations : int
        Number of alternations before the move is judged.
    patience : int
        Moves in a row without a lower objective that end the stage.
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
        """A changed copy of the present model; None if no bone can move."""
        return move_cheapest_bone(run.data, run.present, run.rng, self.alternations, run.locked)


@dataclasses.dataclass(frozen=True, kw_only=True)
class AddAndMerge(MoveBones):
    """Add several bones where the error is largest, and merge down to the number before.

    Attributes
    ----------
    patience : int
        Changes in a row without a lower objective that end the stage.  With 0, one change is made
        and kept in any case, since its worth shows only after the model is relaxed and searched.
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
    """Change the model in one of several ways, polish, and keep the better model.

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
            # Take the change with the longest wait divided by 1 + its recent failures, so that all
            # take turns while they succeed.  Which changes succeed differs between sequences, and
            # between early and late in a run.
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
        """Polish a trial (in place) and return its objective.

        If the objective is close above `base`, the trial is polished once more.
        """
        polish_steps(run.data, trial, STEPS_OF_A_TRIAL, run.locked)
        value = run.value(trial)
        if base <= value < _CLOSE * base:
            polish_steps(run.data, trial, STEPS_OF_A_TRIAL, run.locked)
            value = run.value(trial)
        return value
