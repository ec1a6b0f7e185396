"""A decomposition under way: the walk through a plan.

It is at all times between two small steps and can be stopped, saved and resumed
there.  The best model of exactly the bones asked for is kept apart; what a change
made worse is never handed out.
"""

from __future__ import annotations

import copy
import dataclasses
import time
from typing import Any

import numpy as np

from ..solver.alternation import alternate, bone_step, vertex_step
from ..solver.bone_models import normalise_gauge, polish_of
from ..solver.initialization import single_bone_errors, start_model
from ..solver.model import Fixed, Model
from ..solver.polish import Polish
from ..solver.smoothness import WeightSmoothness
from ..solver.trajectories import Trajectories
from .moves import (
    grow_and_shed,
    kick,
    loosen,
    merge_step,
    polish_steps,
    regrow_step,
    reseed_step,
    thin,
    tighten,
)
from .problem import Given
from .schedule import Op

__all__ = ["Run"]

_WINDOW = 8  # polish steps over which the stopping test looks
_ENTERING = 3  # every third polish step tries bones that could enter
_FEW_FRAMES, _FEW_STEPS = 64, 16  # of the first model, where there are many frames
_FIRST_SWEEPS = 6  # where a frame's bones start from those of another frame
_FIRST_LEAPS = 4  # likewise, where that may be far away
_PLATEAU = 1e-5  # relative gain of an alternation that does not count
_CHANGES = (loosen, grow_and_shed, kick, thin)  # of a search
_MOST_MISSES = 8  # that count against a change
_SETTLE = 8  # polish steps after which a try is judged
_CLOSE = 1.02  # ratio of objectives at which it gets as many again


class Run:
    """A decomposition under way.

    Attributes
    ----------
    model : Model or None
        What the next step starts from; may have more bones than asked for.
    best : Model or None
        Lowest objective so far with exactly the bones asked for.
    best_value : float
    records : list of (iteration, elapsed, squared error, phase)
    """

    def __init__(
        self,
        data: Trajectories,
        plan: list[Op],
        *,
        bones: int,
        influences: int,
        rng: np.random.Generator,
        fixed: Fixed,
        given: Given,
        smooth: WeightSmoothness | None,
        began: float | None = None,
    ) -> None:
        self.data, self.plan = data, plan
        self.bones, self.influences, self.rng = bones, influences, rng
        self.asked, self.given, self.smooth = fixed, given, smooth
        self.model: Model | None = None
        self.best: Model | None = None
        self.best_value = np.inf
        self.records: list[tuple[int, float, float, str]] = []
        self.position, self.iteration, self.settled = 0, 0, False
        self.own = rng  # what `aside` steps draw from
        self.lead: list[float] = []  # `track` of the search that ended lowest
        self._forget()
        self._began = time.perf_counter() if began is None else began
        self._before = 0.0

    @property
    def elapsed(self) -> float:
        return self._before + self.here

    @property
    def here(self) -> float:
        """Seconds since this call began, without those of the run that it resumes."""
        return time.perf_counter() - self._began

    @property
    def finished(self) -> bool:
        return self.position >= len(self.plan)

    @property
    def phase(self) -> str:
        return "done" if self.finished else self.plan[self.position].phase

    @property
    def fixed(self) -> Fixed:
        """What the present step may move, and how."""
        if self.finished or not self.plan[self.position].rigid:
            return self.asked
        return dataclasses.replace(self.asked, bone_model="rigid")

    @property
    def fraction(self) -> float:
        """Share of the plan's work that is done, by its estimated cost."""
        done = total = 0.0
        for k, op in enumerate(self.plan):
            count = min(op.count, 3) if op.phase == "merge" else op.count
            total += count * op.cost
            if k < self.position:
                done += count * op.cost
            elif k == self.position:
                done += min(self.count, count) * op.cost
        return done / total if total else 1.0

    def advance(self) -> None:
        """One small step."""
        op = self.plan[self.position]
        phase = op.phase
        over = getattr(self, f"_do_{phase}")(op)
        self.count += 1
        self._note(phase)
        if over or self.count >= op.count:
            self._next()
        if self.best_value <= 1e-30 * float(self.data.x2.sum()):
            # exact: nothing left to gain
            self.position, self.settled = len(self.plan), True

    def value(self, model: Model) -> float:
        """The objective: squared error, and the smoothness penalty where asked for."""
        extra = 0.0 if self.smooth is None else self.smooth.penalty(model)
        return model.objective(self.data) + extra

    def _note(self, phase: str) -> None:
        model = self.model
        if model is None or model.n_bones != self.bones or model.n_influences > self.influences:
            return
        value = self.value(model)
        if value < self.best_value:
            self.best, self.best_value = model.copy(), value
            # records hold the error alone, without the penalty that `value` may carry
            error = model.objective(self.data)
            self.records.append((self.iteration, self.elapsed, error, phase))

    def _next(self) -> None:
        if self.track and (not self.lead or self.track[-1] < self.lead[-1]):
            self.lead = self.track
        self.position += 1
        self._forget()

    def _forget(self) -> None:
        """What one entry of the plan remembers from step to step."""
        self.count = self.failures = 0
        self.recent: list[float] = []
        self.track: list[float] = []  # the objective before a search and after each try
        # of each change of a search: the try at which it had its last turn, failures since it paid
        self.turns = list(range(-len(_CHANGES), 0))
        self.misses = [0] * len(_CHANGES)
        self.damping: float | None = None
        self._polish: Polish | None = None

    def _draws(self, op: Op) -> np.random.Generator:
        return self.own if op.aside else self.rng

    def _do_compress(self, _: Op) -> bool:
        self.data = self.data.compressed(self.bones)
        return True

    def _do_quick(self, op: Op) -> bool:
        """Start and settle on a few frames where there are many, then on to all of them."""
        data = self.data
        if data.n_frames < 2 * _FEW_FRAMES or self.given.transforms is not None:
            return self._do_start(op)
        chosen = np.linspace(0, data.n_frames - 1, _FEW_FRAMES).round().astype(np.intp)
        few = data.some(chosen)
        rest = data.frame(self.given.rest_frame) if self.given.rest is None else self.given.rest
        model = start_model(
            few, rest, self.bones, self.influences, self.rng, None, self.fixed.bone_model,
            quick=True,
        )  # fmt: skip
        vertex_step(few, model, fixed=self.fixed)
        alternate(few, model, _FEW_STEPS, self.fixed)
        between = 0.5 * (chosen[1:] + chosen[:-1])
        near = np.searchsorted(between, np.arange(data.n_frames))
        model.transforms = np.ascontiguousarray(model.transforms[near])
        bone_step(data, model, sweeps=_FIRST_SWEEPS, fixed=self.fixed)
        vertex_step(data, model, fixed=self.fixed)
        self.model = model
        return True

    def followed_by(
        self, data: Trajectories, plan: list[Op], given: Given, smooth: WeightSmoothness | None
    ) -> Run:
        """A run on other frames that counts on from this one's steps and seconds."""
        run = Run(
            data, plan, bones=self.bones, influences=self.influences, rng=self.rng,
            fixed=self.asked, given=given, smooth=smooth, began=self._began,
        )  # fmt: skip
        run.iteration, run._before = self.iteration, self._before
        return run

    def release(self) -> None:
        """Let go of the trajectories; no further step can be made."""
        self.data = dataclasses.replace(self.data, z=self.data.z[:, :0].copy(), q=None)
        self._polish = None

    def _do_spread(self, _: Op) -> bool:
        """Bones of frames that start with those of others, and the error under them."""
        model = self._current()
        bone_step(self.data, model, sweeps=_FIRST_SWEEPS, fixed=self.fixed, leaps=_FIRST_LEAPS)
        every = np.ones(self.data.n_vertices, dtype=bool)
        as_is = dataclasses.replace(self.fixed, rest=True, weights=every)
        vertex_step(self.data, model, fixed=as_is)
        return True

    def _do_start(self, op: Op) -> bool:
        data, given = self.data, self.given
        if op.aside:
            self.own = copy.deepcopy(self.rng)
        rng = self._draws(op)
        rest = data.frame(given.rest_frame) if given.rest is None else given.rest
        if given.weights is not None:
            bones = given.transforms
            if bones is None:
                from ..solver.initialization import bones_of_weights

                bones = bones_of_weights(
                    data, rest, given.joints, self.bones, self.fixed.bone_model
                )
            model = Model.start(bones.copy(), rest, given.joints[:, 0], self.influences)
            k = min(self.influences, given.joints.shape[1])
            model.joints[:, :k], model.weights[:, :k] = given.joints[:, :k], given.weights[:, :k]
            model.widen()
        elif given.transforms is not None and given.transforms.shape[1] == self.bones:
            bones = given.transforms
            everyone = np.arange(data.n_vertices)
            cost, positions = single_bone_errors(data, given.rest, bones, everyone)
            label = cost.argmin(axis=1)
            if positions is not None:
                rest = np.ascontiguousarray(positions[everyone, :, label])
            model = Model.start(bones.copy(), rest, label, self.influences)
        else:
            most = data.n_vertices
            count = min(most, max(self.bones, round(self.bones * op.amount)))
            model = start_model(
                data, rest, count, self.influences, rng, given.transforms, self.fixed.bone_model,
                quick=op.phase == "quick",
            )  # fmt: skip
        vertex_step(data, model, fixed=self.fixed)
        self.model = model
        return True

    def _do_alternate(self, op: Op) -> bool:
        model = self._current()
        before = self.value(model)
        bone_step(self.data, model, fixed=self.fixed)
        pull = stiff = None
        if self.smooth is not None:
            pull, stiff = self.smooth.terms(model)
        vertex_step(self.data, model, fixed=self.fixed, pull=pull, stiff=stiff)
        normalise_gauge(model, self.data.importance, self.fixed)
        self.iteration += 1
        after = self.value(model)
        still = before - after < max(op.tolerance, _PLATEAU) * before
        self.failures = self.failures + 1 if still else 0
        self.settled = self.failures >= 3
        return self.settled

    def _do_merge(self, op: Op) -> bool:
        model = self._current()
        if model.n_bones > self.bones:
            self.model = merge_step(self.data, model, self.bones, int(op.amount), self.fixed)
            self.iteration += int(op.amount)
        return self._current().n_bones <= self.bones

    def _do_reseed(self, op: Op) -> bool:
        trial = reseed_step(self.data, self._current(), self._draws(op), int(op.amount), self.fixed)
        self.iteration += int(op.amount)
        return True if trial is None else self._better(trial, op)

    def _do_regrow(self, op: Op) -> bool:
        trial = regrow_step(self.data, self._current(), self._draws(op), int(op.amount), self.fixed)
        self.iteration += int(op.amount)
        if op.patience:
            return self._better(trial, op)
        self.model = trial  # to be judged only once it has been relaxed and searched
        return True

    def _better(self, trial: Model, op: Op) -> bool:
        """Go on from the trial if it is better; whether too many in a row were not."""
        if self.value(trial) < self.value(self._current()):
            self.model, self.failures = trial, 0
        else:
            self.failures += 1
        return self.failures >= op.patience

    def _do_polish(self, op: Op) -> bool:
        model = self._current()
        if self._polish is None:
            self._polish = polish_of(self.data, model, fixed=self.fixed, damping=self.damping)
        polish = self._polish
        if not self.recent:
            self.recent = [polish.value]
        polish.step(entering=3 if self.count % _ENTERING == 0 else 0)
        self.damping = polish.damping
        self.iteration += 1
        self.recent = [*self.recent, polish.value][-_WINDOW - 1 :]
        full = len(self.recent) > _WINDOW
        # the objective is a square: its relative change is twice that of the error
        gain = 0.5 * (self.recent[0] - self.recent[-1]) / max(self.recent[0], 1e-300)
        self.settled = full and gain < op.tolerance
        return self.settled

    def _do_relax(self, op: Op) -> bool:
        """Influences more for a while, as many again but four at most; a step gives up one."""
        model, steps, k = self._current(), int(op.amount), self.influences
        if self.count == 0:
            model = model.with_influences(min(2 * k, k + op.count, model.n_bones))
        if model.n_influences > k:
            model = tighten(self.data, model, self.fixed, steps=steps)
            self.iteration += steps
        self.model = model
        return model.n_influences <= k

    def _do_search(self, op: Op) -> bool:
        """Change the model in one of four ways, polish, and keep what is better."""
        model = self._current()
        data, base = self.data, self.value(model)
        if not self.track:
            self.track = [base]
            if self._behind(op.race):
                return True
        kind = self._due()
        trial = _CHANGES[kind](data, model, self._draws(op), self.fixed)
        polish_steps(data, trial, _SETTLE, self.fixed)
        value = self.value(trial)
        if base <= value < _CLOSE * base:
            polish_steps(data, trial, _SETTLE, self.fixed)
            value = self.value(trial)
        self.iteration += _SETTLE
        if value < base:
            self.model = trial
        worth = value < (1.0 - op.tolerance) * base
        self.failures = 0 if worth else self.failures + 1
        self.turns[kind] = self.count
        self.misses[kind] = 0 if worth else min(self.misses[kind] + 1, _MOST_MISSES)
        self.track = [*self.track, min(value, base)]
        self.settled = self.failures >= op.patience
        return self.settled or self._behind(op.race)

    def _behind(self, race: tuple[float, float]) -> bool:
        """Whether the search that ended lowest was well ahead after as many tries."""
        tries = len(self.track) - 1
        if 0 < tries < len(_CHANGES) or tries >= len(self.lead):
            return False
        ratio = race[min(tries, 1)]
        return 0 < ratio * self.lead[tries] < self.track[-1]

    def _due(self) -> int:
        """The change that has waited longest for its turn, of those that failed the less so.

        By turns while all pay; which ones do differs from sequence to sequence and
        from the first rounds to the last.
        """
        waited = [
            (self.count - turn) / (1 + missed)
            for turn, missed in zip(self.turns, self.misses, strict=True)
        ]
        return int(np.argmax(waited))

    def _do_recall(self, op: Op) -> bool:
        assert self.best is not None
        self.model = self.best.widened()
        return True

    def _current(self) -> Model:
        assert self.model is not None
        return self.model

    def progress(self) -> dict[str, Any]:
        """What :meth:`restore` needs beside the models."""
        return {
            "position": self.position, "count": self.count, "failures": self.failures,
            "iteration": self.iteration, "damping": self.damping, "recent": self.recent,
            "turns": self.turns, "misses": self.misses, "track": self.track, "lead": self.lead,
            "settled": self.settled, "elapsed": self.elapsed, "best_value": self.best_value,
            "rng": self.rng.bit_generator.state, "own": self.own.bit_generator.state,
        }  # fmt: skip

    def restore(
        self,
        progress: dict[str, Any],
        model: Model | None,
        best: Model | None,
        records: list[tuple[int, float, float, str]],
    ) -> None:
        """Go on where a saved run was."""
        self.model, self.best, self.records = model, best, records
        self.position, self.count = int(progress["position"]), int(progress["count"])
        if not 0 <= self.position <= len(self.plan) or self.count < 0:
            raise ValueError(f"step {self.count} of entry {self.position}")
        self.failures, self.iteration = int(progress["failures"]), int(progress["iteration"])
        self.damping = progress["damping"]
        self.recent, self.settled = list(progress["recent"]), bool(progress["settled"])
        self.turns, self.misses = list(progress["turns"]), list(progress["misses"])
        self.track, self.lead = list(progress["track"]), list(progress["lead"])
        self.best_value, self._before = float(progress["best_value"]), float(progress["elapsed"])
        self.own = copy.deepcopy(self.rng)
        self.own.bit_generator.state = progress["own"]
        self.rng.bit_generator.state = progress["rng"]
        if any(op.phase == "compress" for op in self.plan[: self.position]):
            self.data = self.data.compressed(self.bones)
