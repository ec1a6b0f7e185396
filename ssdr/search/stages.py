"""The stages of a schedule for bones without joints; each `apply` makes its small steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np

from ..solver.alternation import alternate, bone_step, vertex_step
from ..solver.bone_models import fit_motion, normalise_gauge, polish_of
from ..solver.initialization import bones_of_weights, single_bone_errors, start_model
from ..solver.model import Fixed, Model
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
    "QuickStart",
    "Relax",
    "Search",
    "Spread",
    "Start",
    "StartFromModel",
]

# Frames of a quick start where there are twice as many or more, and alternations on them: 64
# frames tell which bones there are, and 16 alternations place them.
_FEW_FRAMES, _FEW_ALTERNATIONS = 64, 16
# Where bones of a frame start from those of another frame: Gauss–Seidel sweeps, and leaps of all
# bones together, since sweeps alone carry a bone far only in many rounds.
_FIRST_SWEEPS, _FIRST_LEAPS = 6, 4
# An alternation that gains less than this, relative to the objective, does not count.
_PLATEAU = 1e-5
_PLATEAU_ALTERNATIONS = 3  # in a row: fewer end on a pause that is followed by progress
_POLISH_WINDOW = 8  # polish steps over which the stopping test looks
STEPS_OF_A_TRIAL = 8  # polish steps before a trial of a search is judged
_CLOSE = 1.02  # ratio of objectives below which a trial gets as many polish steps again
_MOST_MISSES = 8  # failures that count against a kind of change: none is given up for good

# makes a changed copy of a model
Change = Callable[[Trajectories, Model, np.random.Generator, Fixed], Model]


# --- starts ------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, kw_only=True)
class Start(Stage):
    """Bones from motion, or from what the caller gave, and their first weights.

    Attributes
    ----------
    factor : float
        Bones to start with, relative to those asked for; a merge removes the excess.
    influences : int or None
        Influences of the start; None: those asked for.
    """

    phase: ClassVar[str] = "start"
    cost: float = 8
    factor: float = 1.0
    influences: int | None = None

    def apply(self, run: Run) -> Iterator[None]:
        run.model = self._model(run)
        vertex_step(run.data, run.model, fixed=run.fixed)
        yield

    def _model(self, run: Run, *, quick: bool = False) -> Model:
        data, given = run.data, run.present_parts
        influences = self.influences or run.influences
        rest = data.frame(given.rest_frame) if given.rest is None else given.rest
        bones = given.transforms
        if given.indices is not None and given.weights is not None:
            if bones is None:
                bones = bones_of_weights(data, rest, given.indices, run.bones, run.fixed.bone_model)
            return Model.with_weights(bones.copy(), rest, given.indices, given.weights, influences)
        if bones is not None and bones.shape[1] == run.bones:
            every = np.arange(data.n_vertices)
            cost, positions = single_bone_errors(data, given.rest, bones, every)
            label = cost.argmin(axis=1)
            if positions is not None:
                rest = np.ascontiguousarray(positions[every, :, label])
            return Model.start(bones.copy(), rest, label, influences)
        count = min(data.n_vertices, max(run.bones, round(run.bones * self.factor)))
        kind = run.fixed.bone_model
        return start_model(data, rest, count, influences, run.rng, bones, kind, quick=quick)


@dataclasses.dataclass(frozen=True, kw_only=True)
class QuickStart(Start):
    """A start that is soon made: settled on 64 frames where there are many, then on all."""

    phase: ClassVar[str] = "quick"

    def apply(self, run: Run) -> Iterator[None]:
        data, given = run.data, run.given
        if data.n_frames < 2 * _FEW_FRAMES or given.transforms is not None:
            run.model = self._model(run, quick=True)
            vertex_step(data, run.model, fixed=run.fixed)
            yield
            return
        chosen = np.linspace(0, data.n_frames - 1, _FEW_FRAMES).round().astype(np.intp)
        few = data.some(chosen)
        rest = data.frame(given.rest_frame) if given.rest is None else given.rest
        influences, kind = self.influences or run.influences, run.fixed.bone_model
        model = start_model(few, rest, run.bones, influences, run.rng, None, kind, quick=True)
        vertex_step(few, model, fixed=run.fixed)
        alternate(few, model, _FEW_ALTERNATIONS, run.fixed)
        between = 0.5 * (chosen[1:] + chosen[:-1])
        nearest = np.searchsorted(between, np.arange(data.n_frames))
        model.transforms = np.ascontiguousarray(model.transforms[nearest])
        bone_step(data, model, sweeps=_FIRST_SWEEPS, fixed=run.fixed)
        vertex_step(data, model, fixed=run.fixed)
        run.model = model
        yield


@dataclasses.dataclass(frozen=True, kw_only=True)
class StartFromModel(Stage):
    """A whole model that the caller gave, unchanged where its transforms are of these frames.

    Else its bones are fitted to its weights first.
    """

    phase: ClassVar[str] = "start"
    cost: float = 8

    def apply(self, run: Run) -> Iterator[None]:
        data, given = run.data, run.given
        assert given.rest is not None
        assert given.indices is not None
        assert given.weights is not None
        bones, kind = given.transforms, run.fixed.bone_model
        if bones is None:
            bones = bones_of_weights(data, given.rest, given.indices, run.bones, kind)
        model = Model.with_weights(
            bones.copy(), given.rest, given.indices, given.weights, run.influences
        )
        if given.transforms is None:
            fit_motion(data, model, fixed=run.fixed, sweeps=_FIRST_SWEEPS, leaps=_FIRST_LEAPS)
        model.tree = given.tree if run.rigid_joints else None
        measure_error(run, model)
        run.model = model
        yield


@dataclasses.dataclass(frozen=True, kw_only=True)
class Spread(Stage):
    """Fit the bones of frames that start with those of other frames; measure the error."""

    phase: ClassVar[str] = "spread"
    cost: float = 12

    def apply(self, run: Run) -> Iterator[None]:
        model = run.present
        fit_motion(run.data, model, fixed=run.fixed, sweeps=_FIRST_SWEEPS, leaps=_FIRST_LEAPS)
        measure_error(run, model)
        yield


def measure_error(run: Run, model: Model) -> None:
    """Set the error of every vertex; nothing moves."""
    every = np.ones(run.data.n_vertices, dtype=bool)
    vertex_step(run.data, model, fixed=dataclasses.replace(run.fixed, rest=True, weights=every))


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
            bone_step(data, model, fixed=run.fixed)
            pull = stiff = None
            if run.smoothness is not None:
                pull, stiff = run.smoothness.terms(model)
            vertex_step(data, model, fixed=run.fixed, pull=pull, stiff=stiff)
            normalise_gauge(model, data.importance, run.fixed)
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
                    run.data, model, run.fixed, steps=self.polish_steps
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
        polish = polish_of(run.data, run.present, fixed=run.fixed)
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
            run.model = merge_bones(run.data, run.present, run.bones, self.alternations, run.fixed)
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
            trial = move_cheapest_bone(run.data, run.present, run.rng, self.alternations, run.fixed)
            run.iteration += self.alternations
            if trial is None:
                yield
                return
            failures = 0 if run.accept_if_lower(trial) else failures + 1
            yield
            if failures >= self.patience:
                return


@dataclasses.dataclass(frozen=True, kw_only=True)
class AddAndMerge(Stage):
    """Add several bones where the error is, and merge them down again.

    Attributes
    ----------
    alternations : int
        After each change.
    patience : int
        Failures in a row that end the stage.  0: one step whose result is taken in any case,
        since what it is worth shows only once it has been relaxed and searched.
    """

    phase: ClassVar[str] = "add and merge"
    cost: float = 20
    alternations: int = 3
    patience: int = 0

    def apply(self, run: Run) -> Iterator[None]:
        failures = 0
        for _ in range(self.steps):
            trial = add_and_merge_bones(
                run.data, run.present, run.rng, self.alternations, run.fixed
            )
            run.iteration += self.alternations
            if not self.patience:
                run.model = trial
                yield
                return
            failures = 0 if run.accept_if_lower(trial) else failures + 1
            yield
            if failures >= self.patience:
                return


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
            trial = self.changes[kind](run.data, run.present, run.rng, run.fixed)
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
        polish_steps(run.data, trial, STEPS_OF_A_TRIAL, run.fixed)
        value = run.value(trial)
        if base <= value < _CLOSE * base:
            polish_steps(run.data, trial, STEPS_OF_A_TRIAL, run.fixed)
            value = run.value(trial)
        return value
