"""The best models found for different numbers of bones, and attempts to find better ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from ..search.descent import Descent, Schedule
from ..search.problem import Initial
from ..search.progress import Record, Stop
from ..search.starts import merged_start
from ..search.steps import alternate, merge, move_bones, polish, return_to_best, search
from ..search.trees.tree_steps import attach, remove_bones, search_trees
from ..solver.model import Lowest, Model
from .solved_frames import SolvedFrames

# Factor by which the objective has to fall before the error is measured again, since a measurement
# takes as long as a step.
_RECHECK = 0.97
# Lawson's reweighting: number of rounds, least factor by which a round scales the importance of a
# vertex, and largest error, relative to the tolerance, at which the reweighting is tried.
_LEVEL_ROUNDS, _LEVEL_FLOOR, _LEVELLED = 6, 0.05, 2.0
# For the estimate of the work that is done: the fraction at which pruning begins, the number of
# attempts that usually come before, and the least number of attempts among which the work that is
# left until then is divided equally.
PRUNING, _EXPECTED, _FOLLOWING = 0.95, 12, 4

# Called with the phase of a step, and whether there is a model to return; may raise Stop.
Report = Callable[[str, bool], None]


# --- parts of schedules, for free bones or for bones attached at joints --------------------------


def start_merged(d: Descent, factor: float) -> None:
    """Start with `factor` · `d.bones` bones and merge them down to `d.bones`."""
    if not d.rigid_joints:
        merged_start(d, 10, 6, factor=factor)
        return
    merged_start(d, factor=factor, influences=1)
    move_bones(d)
    attach(d)
    polish(d, steps=20, gain=0.01)
    return_to_best(d)


def merge_down(d: Descent) -> None:
    """Remove the bones whose removal costs least until `d.bones` are left."""
    if d.rigid_joints:
        remove_bones(d)
    else:
        merge(d)
        alternate(d, steps=6)


def move_some(d: Descent, count: int) -> None:
    """Move `count` bones or, with joints, change the tree `count` times."""
    if d.rigid_joints:
        search_trees(d, steps=count)
    else:
        move_bones(d, steps=count, patience=max(4, count // 5))


def search_long(d: Descent, moves: int, trials: int) -> None:
    """Improve the model by a long search.

    Move up to `moves` bones, polish, return to the best model, and try `trials` changes. With rigid
    joints: polish, then try `trials` changes of the tree.
    """
    if d.rigid_joints:
        polish(d, steps=30, gain=0.005)
        move_some(d, trials)
        return
    move_some(d, moves)
    polish(d, steps=30, gain=0.005)
    return_to_best(d)
    search(d, steps=trials, success=0.0)


def polish_reweighted(d: Descent) -> None:
    """Make a few steps after the importance of vertices has changed."""
    if not d.rigid_joints:
        alternate(d, steps=2)
    polish(d, steps=4)


class ModelsByBones:
    """The model of least error found for each number of bones.

    Parameters
    ----------
    frames : SolvedFrames
    report : callable
        Called with the phase of a step, and whether there is a model to return; may raise Stop.
    tolerance : float
        In the mesh's units; an attempt ends once its error is within the tolerance.

    Attributes
    ----------
    best : dict of int to Lowest
        Model of least error for each number of bones, by the measure of `frames`.
    attempts : int
        Number of attempts so far.
    held : list of Model
        Each model that held the tolerance with fewer bones than all previous ones.
    records : list of Record
        One for each model of `held`.
    iteration : int
        Number of alternations and polish steps so far.
    fraction : float
        Estimated fraction of the work that is done.
    """

    def __init__(self, frames: SolvedFrames, report: Report, *, tolerance: float) -> None:
        self.frames, self.report = frames, report
        self.tolerance, self.fraction = tolerance, 0.0
        self.best: dict[int, Lowest] = {}
        self.held: list[Model] = []
        self.records: list[Record] = []
        self.attempts = self.iteration = 0

    @property
    def fewest(self) -> int | None:
        """Fewest bones of a model that holds the tolerance; None if no model does."""
        return min((b for b, m in self.best.items() if m.value <= self.tolerance), default=None)

    @property
    def held_bones(self) -> int:
        """Fewest bones of a model that holds the tolerance, which is known to exist."""
        assert self.fewest is not None
        return self.fewest

    def fits(self, bones: int) -> bool:
        """Whether a model of at most `bones` bones holds the tolerance."""
        return self.fewest is not None and self.fewest <= bones

    @property
    def smallest(self) -> Model | None:
        """Model of the fewest bones that holds the tolerance; if none does, that of least error."""
        if not self.best:
            return None
        if self.fewest is not None:
            return self.best[self.fewest].model
        return min(self.best.values(), key=lambda m: m.value).model

    def attempt(
        self,
        bones: int,
        schedule: Schedule,
        *,
        start: Model | None = None,
        initial: Initial | None = None,
        until: float | None = None,
    ) -> None:
        """Run a schedule, and keep its best model if no other with its number of bones is as good.

        Parameters
        ----------
        bones : int
        schedule : Schedule
        start : Model, optional
            Model to begin with, for schedules that do not make one.
        initial : Initial, optional
            Parts to begin from that replace those of the frames.
        until : float, optional
            Error at which the attempt ends; the tolerance by default.
        """
        frames, until = self.frames, self.tolerance if until is None else until
        d, before = frames.descent(bones, initial=initial), self.iteration
        if start is not None:
            d.begin_with(start)
        following = max(_EXPECTED - self.attempts, _FOLLOWING)
        done, work = self.fraction, (PRUNING - self.fraction) / following
        # The largest error is at least the RMSE, so that neither measure can be within `until`
        # unless the squared error is within this bound.
        worth_checking = (1 + 1e-9) * frames.squared(until)

        def after_step(phase: str) -> None:
            nonlocal worth_checking
            if d.best_error <= worth_checking:
                worth_checking = _RECHECK * d.best_error
                if frames.error(d.best.model) <= until:
                    raise Stop("held")
            ready = d.best.exists or bool(self.best)
            self.fraction, self.iteration = done + work * d.fraction, before + d.work.iteration
            self.report(f"{bones} bone{'s' * (bones > 1)}: {phase}", ready)

        try:
            d.follow(schedule, after_step)
        finally:
            self.iteration = before
            self._keep(d)
        frames.problem.monitor.raise_if_stopped()
        error = self.best[bones].value
        if frames.measure == "max" and self.tolerance < error <= _LEVELLED * self.tolerance:
            self._reweight(d.best.model)

    def _reweight(self, model: Model) -> None:
        """Lower the largest error: each round scales importance by vertex errors (Lawson 1961)."""
        importance = self.frames.data.importance
        for _ in range(_LEVEL_ROUNDS):
            size = np.sqrt(np.maximum(model.error, 0.0))
            importance = importance * (_LEVEL_FLOOR + size / max(float(size.max()), 1e-300))
            importance = importance / importance.mean()
            data = dataclasses.replace(self.frames.data, importance=importance)
            d = self.frames.descent(model.n_bones, data=data)
            d.begin_with(model.with_restarted_support())
            d.follow(polish_reweighted)
            model = d.best.model
            self._keep(d)
            if self.fits(model.n_bones):
                return
            self.report(f"{model.n_bones} bones: level", True)

    def _keep(self, d: Descent) -> None:
        self.iteration += d.work.iteration
        if not d.best.exists:
            return
        model, fewest = d.best.model, self.fewest
        error, bones = self.frames.error(model), model.n_bones
        self.attempts += 1
        self.best.setdefault(bones, Lowest()).offer(model, error)
        if error <= self.tolerance and (fewest is None or bones < fewest):
            self.held.append(model)
            rmse = self.frames.error(model, "rmse")
            elapsed = self.frames.problem.monitor.elapsed
            record = Record(iteration=self.iteration, elapsed=elapsed, rmse=rmse, phase="bones")
            self.records.append(record)
