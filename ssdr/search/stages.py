"""The stages that a schedule is made of, each with its few numbers and its own step.

Thresholds are chosen by hand unless an experiment is named; those are in ``docs/theory.md``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from ..solver.alternation import alternate, bone_step, vertex_step
from ..solver.gauge import normalise_gauge
from ..solver.gauss_newton import GaussNewton, fit_motion
from ..solver.initialization import fit_patches, single_bone_errors, start_model
from ..solver.model import Fixed, Model
from ..solver.trajectories import Trajectories
from .moves import (
    entering_at,
    grow_and_shed,
    kick,
    loosen,
    merge_step,
    polish_steps,
    regrow_step,
    reseed_step,
    shed_influence,
    thin,
)
from .run import Run, Stage

__all__ = [
    "POLISH_STEPS_OF_A_TRY",
    "Alternate",
    "Compress",
    "Merge",
    "Polish",
    "QuickStart",
    "Regrow",
    "Relax",
    "Reseed",
    "Search",
    "Spread",
    "Start",
]

# Frames of the first model where there are twice as many or more, and alternations on them: 64
# frames tell which bones there are, and 16 alternations place them.
_FEW_FRAMES, _FEW_ALTERNATIONS = 64, 16
# Where bones of a frame start from those of another frame: Gauss–Seidel sweeps, and leaps of all
# bones together, since sweeps alone carry a bone far only in many rounds.
_FIRST_SWEEPS, _FIRST_LEAPS = 6, 4
# An alternation that gains less than this, relative to the objective, does not count.
_PLATEAU = 1e-5
_PLATEAU_ALTERNATIONS = 3  # in a row: fewer end on a pause that is followed by progress
_POLISH_WINDOW = 8  # polish steps over which the stopping test looks
POLISH_STEPS_OF_A_TRY = 8  # after which a try of a search is judged
_CLOSE = 1.02  # ratio of objectives at which a try gets as many polish steps again
# makes a changed copy of a model
Change = Callable[[Trajectories, Model, np.random.Generator, Fixed], Model]
_MOST_MISSES = 8  # failures that count against a kind of change: none is given up for good


@dataclasses.dataclass(frozen=True, kw_only=True)
class Start(Stage):
    """Bones from motion, or from what the caller prescribed, and their first weights.

    Attributes
    ----------
    factor : float
        Bones to start with, relative to those asked for; a merge brings them down again.
    influences : int or None
        Of the start; None: those asked for.
    """

    phase: ClassVar[str] = "start"
    quick: ClassVar[bool] = False
    cost: float = 8
    factor: float = 1.0
    influences: int | None = None

    def step(self, run: Run) -> bool:
        if self.branch:
            run.start_branch()
        run.model = self._model(run)
        vertex_step(run.data, run.model, fixed=run.fixed)
        return True

    def _model(self, run: Run) -> Model:
        data, prescribed, influences = (
            run.data,
            run.present_parts,
            self.influences or run.influences,
        )
        rest = data.frame(prescribed.rest_frame) if prescribed.rest is None else prescribed.rest
        bones, indices, weights = prescribed.transforms, prescribed.indices, prescribed.weights
        if indices is not None and weights is not None:
            if bones is None:
                bones = fit_patches(
                    data, rest, indices[:, 0].astype(np.intp), run.bones, run.fixed.bone_model
                )
            return Model.with_weights(bones.copy(), rest, indices, weights, influences)
        if bones is not None and bones.shape[1] == run.bones:
            every = np.arange(data.n_vertices)
            cost, positions = single_bone_errors(data, prescribed.rest, bones, every)
            label = cost.argmin(axis=1)
            if positions is not None:
                rest = np.ascontiguousarray(positions[every, :, label])
            return Model.start(bones.copy(), rest, label, influences)
        count = min(data.n_vertices, max(run.bones, round(run.bones * self.factor)))
        return start_model(
            data,
            rest,
            count,
            influences,
            run.generator,
            bones,
            run.fixed.bone_model,
            quick=self.quick,
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class QuickStart(Start):
    """A start that is soon there: settled on a few frames where there are many, then on all."""

    phase: ClassVar[str] = "quick"
    quick: ClassVar[bool] = True

    def step(self, run: Run) -> bool:
        data, prescribed = run.data, run.prescribed
        if data.n_frames < 2 * _FEW_FRAMES or prescribed.transforms is not None:
            return super().step(run)
        chosen = np.linspace(0, data.n_frames - 1, _FEW_FRAMES).round().astype(np.intp)
        few = data.select_frames(chosen)
        rest = data.frame(prescribed.rest_frame) if prescribed.rest is None else prescribed.rest
        model = start_model(
            few,
            rest,
            run.bones,
            self.influences or run.influences,
            run.rng,
            None,
            run.fixed.bone_model,
            quick=True,
        )
        vertex_step(few, model, fixed=run.fixed)
        alternate(few, model, _FEW_ALTERNATIONS, run.fixed)
        between = 0.5 * (chosen[1:] + chosen[:-1])
        nearest = np.searchsorted(between, np.arange(data.n_frames))
        model.transforms = np.ascontiguousarray(model.transforms[nearest])
        bone_step(data, model, sweeps=_FIRST_SWEEPS, fixed=run.fixed)
        vertex_step(data, model, fixed=run.fixed)
        run.model = model
        return True


@dataclasses.dataclass(frozen=True, kw_only=True)
class Compress(Stage):
    """From here on the frames are as few combinations of frames as hold what matters."""

    phase: ClassVar[str] = "compress"
    cost: float = 4

    def step(self, run: Run) -> bool:
        self.prepare(run)
        return True

    def prepare(self, run: Run) -> None:
        run.compress()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Alternate(Stage):
    """Bones, then weights and rest pose: the alternation of Le and Deng.

    Attributes
    ----------
    gain : float
        Relative gain in the objective that an alternation has to bring: three in a row that
        bring less end the stage.
    """

    phase: ClassVar[str] = "alternate"
    gain: float = _PLATEAU

    def step(self, run: Run) -> bool:
        model, data, memory = run.present, run.data, run.memory
        before = run.value(model)
        bone_step(data, model, fixed=run.fixed)
        pull = stiff = None
        if run.smoothness is not None:
            pull, stiff = run.smoothness.terms(model)
        vertex_step(data, model, fixed=run.fixed, pull=pull, stiff=stiff)
        normalise_gauge(model, data.importance, run.fixed)
        run.iteration += 1
        after = run.value(model)
        still = before - after < max(self.gain, _PLATEAU) * before
        memory.failures = memory.failures + 1 if still else 0
        run.converged = memory.failures >= _PLATEAU_ALTERNATIONS
        return run.converged


@dataclasses.dataclass(frozen=True, kw_only=True)
class Merge(Stage):
    """Give up the cheapest third of the bones too many, alternate, and again until none is.

    Attributes
    ----------
    alternations : int
        After each.
    """

    phase: ClassVar[str] = "merge"
    steps: int = 1000
    cost: float = 20
    alternations: int = 4

    @property
    def expected_steps(self) -> int:
        return 3  # thirds of 0.6 bones too many for each asked for

    def step(self, run: Run) -> bool:
        if run.present.n_bones > run.bones:
            run.model = merge_step(run.data, run.present, run.bones, self.alternations, run.fixed)
            run.iteration += self.alternations
        return run.present.n_bones <= run.bones


@dataclasses.dataclass(frozen=True, kw_only=True)
class Reseed(Stage):
    """Move one of the cheapest bones to where the error is; what is better stays.

    Attributes
    ----------
    alternations : int
        After which the move is judged.
    patience : int
        Failures in a row that end the stage.
    """

    phase: ClassVar[str] = "reseed"
    steps: int = 16
    cost: float = 6
    alternations: int = 4
    patience: int = 4

    def step(self, run: Run) -> bool:
        trial = reseed_step(run.data, run.present, run.generator, self.alternations, run.fixed)
        run.iteration += self.alternations
        return True if trial is None else run.judge(trial, self.patience)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Regrow(Stage):
    """Several bones more where the error is, merged down again.

    Attributes
    ----------
    alternations : int
        After each change.
    patience : int
        Failures in a row that end the stage.  0: one step, taken whatever comes of it, for what
        it is worth shows only once it has been relaxed and searched.
    """

    phase: ClassVar[str] = "regrow"
    cost: float = 20
    alternations: int = 3
    patience: int = 0

    def step(self, run: Run) -> bool:
        trial = regrow_step(run.data, run.present, run.generator, self.alternations, run.fixed)
        run.iteration += self.alternations
        if self.patience:
            return run.judge(trial, self.patience)
        run.model = trial
        return True


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

    def step(self, run: Run) -> bool:
        model, k = run.present, run.influences
        if run.memory.count == 0:
            model = model.with_influences(min(2 * k, k + self.steps, model.n_bones))
        if model.n_influences > k:
            model = shed_influence(run.data, model, run.fixed, steps=self.polish_steps)
            run.iteration += self.polish_steps
        run.model = model
        return model.n_influences <= k


@dataclasses.dataclass(frozen=True, kw_only=True)
class Polish(Stage):
    """Variable-projection Gauss–Newton steps of all bones together.

    Attributes
    ----------
    gain : float
        Relative gain in the error, over eight steps, below which the stage ends.
    """

    phase: ClassVar[str] = "polish"
    cost: float = 6
    gain: float = 0.0

    def step(self, run: Run) -> bool:
        model, memory = run.present, run.memory
        if run.polish is None:
            run.polish = GaussNewton(
                run.data,
                model,
                fixed=run.fixed,
                damping=memory.damping,
                recycled=run.recycled,
            )
        polish = run.polish
        if not memory.recent:
            memory.recent = [polish.value]
        polish.step(entering=entering_at(memory.count))
        memory.damping, run.recycled = polish.damping, polish.recycled
        run.iteration += 1
        memory.recent = [*memory.recent, polish.value][-_POLISH_WINDOW - 1 :]
        full = len(memory.recent) > _POLISH_WINDOW
        # the objective is a square: its relative change is twice that of the error
        gain = 0.5 * (memory.recent[0] - memory.recent[-1]) / max(memory.recent[0], 1e-300)
        run.converged = full and gain < self.gain
        return run.converged


@dataclasses.dataclass(frozen=True, kw_only=True)
class Search(Stage):
    """Change the model in one of four ways, polish, and keep what is better.

    Attributes
    ----------
    patience : int
        Tries in a row without success that end the stage.
    gain : float
        Relative gain in the objective that makes a try a success.
    race : (float, float)
        The search gives up where the objective is above this many times that of the search
        that ended lowest, at the same try: before the first try, and once each kind of change
        had its turn.  0: never.
    """

    phase: ClassVar[str] = "search"
    kinds: ClassVar[tuple[Change, ...]] = (loosen, grow_and_shed, kick, thin)
    changes: ClassVar[int] = len(kinds)
    cost: float = 60
    patience: int
    gain: float = 1e-3
    race: tuple[float, float] = (0.0, 0.0)

    def step(self, run: Run) -> bool:
        model, data, memory = run.present, run.data, run.memory
        base = run.value(model)
        if not memory.track:
            memory.track = [base]
            memory.turns = list(range(-len(self.kinds), 0))
            memory.misses = [0] * len(self.kinds)
            if self._behind(run):
                return True
        kind = self.next_change(run)
        trial = self.kinds[kind](data, model, run.generator, run.fixed)
        value = self.settle(run, trial, base)
        run.iteration += POLISH_STEPS_OF_A_TRY
        if value < base:
            run.model = trial
        success = value < (1.0 - self.gain) * base
        memory.failures = 0 if success else memory.failures + 1
        memory.turns[kind] = memory.count
        memory.misses[kind] = 0 if success else min(memory.misses[kind] + 1, _MOST_MISSES)
        memory.track = [*memory.track, min(value, base)]
        run.converged = memory.failures >= self.patience
        return run.converged or self._behind(run)

    def settle(self, run: Run, trial: Model, base: float) -> float:
        """Polish a trial (in place) before it is judged; its objective."""
        polish_steps(run.data, trial, POLISH_STEPS_OF_A_TRY, run.fixed)
        value = run.value(trial)
        if base <= value < _CLOSE * base:
            polish_steps(run.data, trial, POLISH_STEPS_OF_A_TRY, run.fixed)
            value = run.value(trial)
        return value

    def _behind(self, run: Run) -> bool:
        """Whether the search that ended lowest was well ahead after as many tries."""
        track, leader = run.memory.track, run.leader
        tries = len(track) - 1
        if 0 < tries < len(self.kinds) or tries >= len(leader):
            return False
        ratio = self.race[min(tries, 1)]
        return 0 < ratio * leader[tries] < track[-1]

    @staticmethod
    def next_change(run: Run) -> int:
        """The change whose wait, divided by 1 + its recent failures, is the longest.

        By turns while all pay; which ones do differs from sequence to sequence and
        from the first rounds to the last.
        """
        waited = [
            (run.memory.count - turn) / (1 + missed)
            for turn, missed in zip(run.memory.turns, run.memory.misses, strict=True)
        ]
        return int(np.argmax(waited))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Spread(Stage):
    """Bones of frames that start with those of other frames, and the error under them."""

    phase: ClassVar[str] = "spread"
    cost: float = 12

    def step(self, run: Run) -> bool:
        model = run.present
        fit_motion(run.data, model, fixed=run.fixed, sweeps=_FIRST_SWEEPS, leaps=_FIRST_LEAPS)
        every = np.ones(run.data.n_vertices, dtype=bool)
        as_is = dataclasses.replace(run.fixed, rest=True, weights=every)
        vertex_step(run.data, model, fixed=as_is)
        return True
