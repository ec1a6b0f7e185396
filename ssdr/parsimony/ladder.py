"""Models of different numbers of bones: of each number the lowest that was found.

The search for the smallest model and the curve of error against size both fill such a ladder.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from ..drivers.schedule import merged_start
from ..joints.stages import AttachToJoints, RemoveBones, SearchTrees
from ..search.given import Given
from ..search.progress import Clock, Record
from ..search.run import Run, Schedule
from ..search.sampling import ReturnToBest
from ..search.stages import Alternate, Merge, MoveBones, Polish, Search
from ..solver.model import Model
from ..solver.trajectories import Trajectories
from .report import Attempt
from .solved_frames import SolvedFrames

__all__ = ["Ladder", "Report", "Stages", "Stopped"]

# Decrease of the objective before the error is measured again, which costs as much as a step.
_RECHECK = 0.97
# Rounds of Lawson's reweighting, the importance that a vertex without error keeps in each, and the
# largest error, relative to the tolerance, that such rounds may bring down to it.
_LEVEL_ROUNDS, _LEVEL_FLOOR, _LEVELLED = 6, 0.05, 2.0


class Stopped(Exception):
    """The caller or the time limit ended the search; `reason` as in a decomposition."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


# called with phase, iteration, fraction done, and whether there is a model to return; raises
# Stopped if no other step shall follow
Report = Callable[[str, int, float, bool], None]


@dataclasses.dataclass(frozen=True)
class Stages:
    """Parts of schedules for free bones, or for bones that hang on joints.

    Attributes
    ----------
    rigid_joints : bool
    """

    rigid_joints: bool

    def start(self, factor: float) -> Schedule:
        """Start with `factor` times the bones asked for, and merge them down."""
        if not self.rigid_joints:
            return merged_start(10, 6, factor=factor)
        attach = (AttachToJoints(), Polish(steps=20, gain=0.01), ReturnToBest())
        return (*merged_start(12, 6, factor=factor, influences=1), MoveBones(), *attach)

    def merge(self) -> Schedule:
        """Remove the cheapest bones of a model of more bones than asked for."""
        return (RemoveBones(),) if self.rigid_joints else (Merge(), Alternate(steps=6))

    def move(self, count: int) -> Schedule:
        """Move so many bones, or change the tree so often."""
        if self.rigid_joints:
            return (SearchTrees(steps=count, patience=count),)
        return (MoveBones(steps=count, patience=max(4, count // 5)),)

    def search(self, moves: int, trials: int) -> Schedule:
        """Search for long around the lowest model."""
        polish = Polish(steps=30, gain=0.005)
        if self.rigid_joints:
            return (polish, *self.move(trials))
        search = Search(steps=trials, patience=trials, gain=0.0)
        return (*self.move(moves), polish, ReturnToBest(), search)


class Ladder:
    """Models of different numbers of bones: of each number the lowest that was found.

    Parameters
    ----------
    frames : SolvedFrames
    report : Report
    clock : Clock
    tolerance : float
        In the mesh's units; 0: no attempt ends early.

    Attributes
    ----------
    models, errors : dict of int to Model, dict of int to float
        By number of bones; errors as the tolerance means them.
    attempts : list of Attempt
    held : list of Model
        Every model that held the tolerance and had fewer bones than those before.
    records : list of Record
        One for each of them.
    iteration : int
        Alternations and polish steps so far.
    stages : Stages
    """

    def __init__(
        self, frames: SolvedFrames, report: Report, clock: Clock, tolerance: float = 0.0
    ) -> None:
        self.frames, self.report, self.clock = frames, report, clock
        self.tolerance = tolerance
        self.models: dict[int, Model] = {}
        self.errors: dict[int, float] = {}
        self.attempts: list[Attempt] = []
        self.held: list[Model] = []
        self.records: list[Record] = []
        self.iteration = 0
        self.stages = Stages(frames.problem.rig == "rigid")

    @property
    def fewest(self) -> int | None:
        """The fewest bones that hold the tolerance; None where no model does."""
        return min((b for b, e in self.errors.items() if e <= self.tolerance), default=None)

    def fits(self, bones: int) -> bool:
        """Whether a model of at most so many bones holds the tolerance."""
        return self.fewest is not None and self.fewest <= bones

    @property
    def smallest(self) -> Model | None:
        """The model of the fewest bones that hold the tolerance, else the one of least error."""
        if not self.models:
            return None
        return self.models[self.fewest or min(self.errors, key=self.errors.__getitem__)]

    def attempt(
        self,
        bones: int,
        schedule: Schedule,
        name: str,
        *,
        start: Model | None = None,
        given: Given | None = None,
        until: float | None = None,
        part: tuple[float, float] = (0.0, 1.0),
    ) -> None:
        """Go through a schedule; keep its best model if it is the lowest of so many bones.

        Parameters
        ----------
        bones : int
        schedule : Schedule
        name : str
            What the attempt starts from.
        start : Model, optional
            For schedules that do not begin with a start.
        given : Given, optional
            In place of the ladder's.
        until : float, optional
            Error at which the attempt ends early; the tolerance by default.
        part : (float, float)
            Fractions of the whole work that are done before and after the attempt.
        """
        frames, until = self.frames, self.tolerance if until is None else until
        run = self._run(frames.data, schedule, bones, given)
        if start is not None:
            run.begin_with(start)
        # the RMSE is at most the largest error: what misses this misses either tolerance
        worth_checking = (1 + 1e-9) * frames.squared(until)

        def after_step(phase: str) -> str | None:
            nonlocal worth_checking
            if run.best_value <= worth_checking:
                worth_checking = _RECHECK * run.best_value
                if frames.error(run.best_model) <= until:
                    return "held"
            ready = run.best is not None or bool(self.models)
            fraction = part[0] + (part[1] - part[0]) * run.fraction
            phase = f"{bones} bone{'s' * (bones > 1)}: {phase}"
            self.report(phase, self.iteration + run.iteration, fraction, ready)
            return None

        try:
            run.drive(after_step)
        finally:
            self._keep(run, name)
        level = frames.measure == "max" and self.tolerance < self.errors[bones]
        if level and self.errors[bones] <= _LEVELLED * self.tolerance:
            self._level(run.best_model, part[1])

    def _run(
        self, data: Trajectories, schedule: Schedule, bones: int, given: Given | None = None
    ) -> Run:
        problem = self.frames.problem
        if given is None:
            given = Given() if problem.start is not None else self.frames.given
        return Run(
            data,
            schedule,
            bones=bones,
            influences=problem.influences,
            rng=problem.rng,
            locked=problem.locked,
            given=given,
            rigid_joints=self.stages.rigid_joints,
        )

    def _level(self, model: Model, fraction: float) -> None:
        """Lower the largest error: each round a vertex counts by its error (Lawson 1961)."""
        importance = self.frames.data.importance
        first = () if self.stages.rigid_joints else (Alternate(steps=2),)
        for _ in range(_LEVEL_ROUNDS):
            size = np.sqrt(np.maximum(model.error, 0.0))
            importance = importance * (_LEVEL_FLOOR + size / max(float(size.max()), 1e-300))
            importance = importance / importance.mean()
            data = dataclasses.replace(self.frames.data, importance=importance)
            run = self._run(data, (*first, Polish(steps=4)), model.n_bones)
            run.begin_with(model.with_restarted_support())
            run.drive()
            model = run.best_model
            self._keep(run, "levelled")
            if self.fits(model.n_bones):
                return
            self.report(f"{model.n_bones} bones: level", self.iteration, fraction, True)

    def _keep(self, run: Run, name: str) -> None:
        self.iteration += run.iteration
        model, fewest = run.best, self.fewest
        if model is None:
            return
        error, bones = self.frames.error(model), model.n_bones
        self.attempts.append(Attempt(bones, error, run.iteration, name))
        if error < self.errors.get(bones, np.inf):
            self.models[bones], self.errors[bones] = model, error
        if error <= self.tolerance and (fewest is None or bones < fewest):
            self.held.append(model)
            rmse, elapsed = self.frames.error(model, "rmse"), self.clock.elapsed
            record = Record(iteration=self.iteration, elapsed=elapsed, rmse=rmse, phase="bones")
            self.records.append(record)
