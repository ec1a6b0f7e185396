"""The order of the solver's steps, and the run that walks through it.

    start -> alternate                                      a first model, soon
    start -> alternate -> merge -> alternate -> re-seed -> relax -> polish | search
    spread -> polish                                        a model of some frames, on more

A run is at all times between two small steps: it can be stopped, saved and
resumed there.  The best model of exactly the bones asked for is kept apart;
what a change made worse is never handed out.
"""

from __future__ import annotations

import dataclasses
import hashlib
import time
from typing import Any, Literal

import numpy as np

from .given import Given
from .initialization import single_bone_errors, start_model
from .model import Fixed, Model, bone_step, vertex_step
from .projection import Polish
from .reseeding import (
    alternate,
    grow_and_shed,
    kick,
    loosen,
    merge_step,
    polish_steps,
    reseed_step,
    tighten,
)
from .smoothness import WeightSmoothness
from .stretching import normalise_gauge, polish_of
from .trajectories import Trajectories

__all__ = ["EFFORTS", "Op", "Run", "make_plan", "plan_print", "settling_plan"]

Phase = Literal[
    "quick", "compress", "start", "alternate", "merge", "reseed", "relax", "search", "polish",
    "recall", "spread",
]  # fmt: skip

_WINDOW = 8  # polish steps over which the stopping test looks
_ENTERING = 3  # every third polish step tries bones that could enter
_FEW_FRAMES, _FEW_STEPS = 64, 16  # of the first model, where there are many frames
_FIRST_SWEEPS = 6  # where a frame's bones start from those of another frame
_FIRST_LEAPS = 4  # likewise, where that may be far away
_SETTLING = {"fast": 6, "balanced": 20, "best": 60}  # steps of a polish on more frames
_PLATEAU = 1e-5  # relative gain of an alternation that does not count


@dataclasses.dataclass(frozen=True)
class Op:
    """One entry of the plan.

    `count` steps at most; `amount` is the bones to start with relative to those
    asked for (start), alternations a step (merge, reseed), polish steps at each
    number of influences (relax), failures in a row at which to stop (`patience`:
    reseed, search), relative gain at which to stop (`tolerance`: of three
    alternations, of eight polish steps) or that makes a try a success (of the
    objective, search); `cost` in alternations a step, for the time left.
    """

    phase: Phase
    count: int = 1
    amount: float = 0.0
    patience: int = 0
    tolerance: float = 0.0
    cost: float = 1.0


# On the frames as they are and without a bone too many: what it finds is soon there to be
# had, and now and then stays the best.
_FIRST = [Op("quick", cost=8), Op("alternate", count=20, tolerance=0.01), Op("compress", cost=4)]


def _begin(factor: float, first: int, second: int) -> list[Op]:
    return [
        Op("start", amount=factor, cost=8),
        Op("alternate", count=first),
        Op("merge", count=1000, amount=4, cost=20),
        Op("alternate", count=second),
    ]


def _polish(count: int, tolerance: float) -> Op:
    return Op("polish", count=count, tolerance=tolerance, cost=6)


_MOST_EXTRA = 4  # influences more for a while: a vertex of the polish costs (K + 2)² numbers
_RELAX = Op("relax", count=_MOST_EXTRA, amount=8, cost=40)
_TRIES = {2e7: 30, 1e7: 70, 5e6: 100, 0.0: 160}  # of "best", by vertices × frames × bones
_CHANGES = (loosen, grow_and_shed, kick)  # of a search, by turns
_SETTLE = 8  # polish steps after which a try is judged
_CLOSE = 1.02  # ratio of objectives at which it gets as many again


EFFORTS: dict[str, list[Op]] = {
    "fast": [*_FIRST, *_begin(1.6, 6, 4), Op("recall", cost=0), _polish(6, 0.02)],
    "balanced": [
        *_FIRST,
        *_begin(1.6, 12, 6),
        Op("recall", cost=0),
        Op("reseed", count=16, amount=4, patience=4, cost=6),
        dataclasses.replace(_RELAX, amount=6, cost=30),
        _polish(40, 0.01),
    ],
    "best": [
        *_FIRST, _RELAX, _polish(8, 0.0),
        *_begin(1.6, 12, 6), _RELAX, _polish(8, 0.0),
        *_begin(2.2, 12, 6), _RELAX, _polish(8, 0.0),
        *_begin(3.0, 12, 6), _RELAX, _polish(8, 0.0),
        Op("recall", cost=0),
        Op("search", patience=24, tolerance=1e-3, cost=60),  # its count goes by the size
        Op("recall", cost=0),
        _polish(60, 0.002),
    ],
}  # fmt: skip


def make_plan(
    effort: str, *, fixed: Fixed, bones: int, given: Given, smooth: bool, size: float
) -> list[Op]:
    """The plan of an effort, less what fixed parts and smoothness rule out.

    `size` is vertices × frames × bones.
    """
    plan = list(EFFORTS[effort])
    tries = next(count for least, count in _TRIES.items() if size >= least)
    plan = [dataclasses.replace(op, count=tries) if op.phase == "search" else op for op in plan]
    all_bones = fixed.bones is not None and bool(fixed.locked(bones).all())
    if given.weights is not None or all_bones:
        # nothing to place: one start, then down to the nearest minimum
        steps = {"fast": 10, "balanced": 40, "best": 120}[effort]
        plan = [
            Op("compress", cost=4), Op("start", amount=1.0, cost=8),
            Op("alternate", count=10), _polish(steps, 1e-3),
        ]  # fmt: skip
    if smooth:
        # the polish does not know the penalty: alternate until it settles
        steps = {"fast": 20, "balanced": 100, "best": 400}[effort]
        plan = [op for op in plan if op.phase not in ("polish", "relax", "search")]
        plan.append(Op("alternate", count=steps))
    return plan


def settling_plan(effort: str, smooth: bool) -> list[Op]:
    """What a model of some frames goes through when it is carried to more of them."""
    steps = Op(
        "alternate" if smooth else "polish", count=_SETTLING[effort], tolerance=0.002, cost=6
    )
    return [Op("spread", cost=12), steps]


def plan_print(plan: list[Op]) -> str:
    """Tells the steps of one version of this package from those of another."""
    return hashlib.sha256(repr([plan, sorted(_SETTLING.items())]).encode()).hexdigest()


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
        self.fixed, self.given, self.smooth = fixed, given, smooth
        self.model: Model | None = None
        self.best: Model | None = None
        self.best_value = np.inf
        self.records: list[tuple[int, float, float, str]] = []
        self.position, self.count, self.failures, self.iteration = 0, 0, 0, 0
        self.damping: float | None = None
        self.recent: list[float] = []
        self.settled = False
        self._polish: Polish | None = None
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
        self.position += 1
        self.count = self.failures = 0
        self.recent = []
        self._polish, self.damping = None, None

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
            fixed=self.fixed, given=given, smooth=smooth, began=self._began,
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
        data, given, rng = self.data, self.given, self.rng
        rest = data.frame(given.rest_frame) if given.rest is None else given.rest
        if given.weights is not None:
            bones = given.transforms
            if bones is None:
                from .bones import bones_of_weights

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
        model = self._current()
        trial = reseed_step(self.data, model, self.rng, int(op.amount), self.fixed)
        self.iteration += int(op.amount)
        if trial is None:
            return True
        if self.value(trial) < self.value(model):
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
            model = model.with_influences(min(2 * k, k + _MOST_EXTRA, model.n_bones))
        if model.n_influences > k:
            model = tighten(self.data, model, self.fixed, steps=steps)
            self.iteration += steps
        self.model = model
        return model.n_influences <= k

    def _do_search(self, op: Op) -> bool:
        """Change the model by turns in three ways, polish, and keep what is better."""
        model = self._current()
        data, base = self.data, self.value(model)
        change = _CHANGES[self.count % len(_CHANGES)]
        trial = change(data, model, self.rng, self.fixed)
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
        self.settled = self.failures >= op.patience
        return self.settled

    def _do_recall(self, op: Op) -> bool:
        assert self.best is not None
        self.model = self.best.copy()
        self.model.widen()
        return True

    def _current(self) -> Model:
        assert self.model is not None
        return self.model

    def progress(self) -> dict[str, Any]:
        """What :meth:`restore` needs beside the models."""
        return {
            "position": self.position, "count": self.count, "failures": self.failures,
            "iteration": self.iteration, "damping": self.damping, "recent": self.recent,
            "settled": self.settled, "elapsed": self.elapsed, "best_value": self.best_value,
            "rng": self.rng.bit_generator.state,
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
        self.failures, self.iteration = int(progress["failures"]), int(progress["iteration"])
        self.damping = progress["damping"]
        self.recent, self.settled = list(progress["recent"]), bool(progress["settled"])
        self.best_value, self._before = float(progress["best_value"]), float(progress["elapsed"])
        self.rng.bit_generator.state = progress["rng"]
        if any(op.phase == "compress" for op in self.plan[: self.position]):
            self.data = self.data.compressed(self.bones)
