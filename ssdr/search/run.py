"""A run through the stages of a schedule, which remembers the best model.

The best model of exactly the bones asked for is kept apart from the one that the next step starts
from, which may have more bones, more influences or, after a change, more error.
"""

from __future__ import annotations

import dataclasses
import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..errors import Cancelled
from ..parallel import serial_blas
from ..solver.alternation import bone_costs
from ..solver.model import Locked, Model
from ..solver.objective import Objective
from ..solver.smoothness import WeightSmoothness
from ..solver.trajectories import Trajectories
from .given import Given
from .progress import Clock, ProgressReport

__all__ = ["Lowest", "Run", "Schedule", "Stage"]

_logger = logging.getLogger(__name__)
# Objective, relative to the squared motion, below which all that is left is rounding.
_EXACT = 1e-30
# Rise of the objective, likewise, that solving for a bone leaves to rounding: a bone whose removal
# costs less is idle.
_NO_LOSS = 1e-13


@dataclasses.dataclass(frozen=True, kw_only=True)
class Stage(ABC):
    """One entry of a schedule: a step, repeated until it stops improving or `steps` is reached.

    Attributes
    ----------
    steps : int
        At most.
    cost : float
        Time of a step in alternations; serves the estimate of the time left alone.
    rigid : bool
        Use rigid bones, whatever kind was asked for.
    """

    phase: ClassVar[str]
    steps: int = 1
    cost: float = 1.0
    rigid: bool = False

    @property
    def work(self) -> float:
        """Expected time in alternations."""
        return self.steps * self.cost

    @abstractmethod
    def apply(self, run: Run) -> Iterator[None]:
        """Make the steps; yield after each."""


Schedule = tuple[Stage, ...]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Lowest(Stage):
    """Run several schedules, each from its own start; continue from the lowest model.

    Attributes
    ----------
    starts : tuple of Schedule
    """

    phase: ClassVar[str] = "lowest"
    cost: float = 0.0
    starts: tuple[Schedule, ...]

    @property
    def work(self) -> float:
        return sum(stage.work for start in self.starts for stage in start)

    def apply(self, run: Run) -> Iterator[None]:
        lowest, least = None, np.inf
        for start in self.starts:
            for stage in start:
                yield from run.steps_of(stage)
            if lowest is None or run.value(run.present) < least:
                lowest, least = run.present.copy(), run.value(run.present)
        run.model = lowest


class Run:
    """A decomposition under way.

    Parameters
    ----------
    data : Trajectories
    schedule : sequence of Stage
    bones, influences : int
    rng : numpy.random.Generator
    locked : Locked
        What stays as it is, and what bones may do.
    given : Given
        Parts that the caller gave, in the solver's space.
    smoothness : WeightSmoothness or None
        Penalty on the weights.
    clock : Clock, optional
    rigid_joints : bool
        Accept only models whose bones are attached to their joints.

    Attributes
    ----------
    whole : Trajectories
        All vertices.
    data : Trajectories
        What the present step works on: all vertices, or a sample of them.
    chosen : (n,) int array or None
        The vertices of that sample.
    model : Model or None
        What the next step starts from; may have more bones than asked for.
    best : Model or None
        Lowest objective so far with exactly the bones asked for.
    best_value : float
    stage : Stage or None
        The one whose step comes next.
    iteration : int
        Alternations and polish steps so far.
    converged : bool
        True if the last stage ended by its own stopping test.
    finished : bool
        True once no stage is left.
    records : list of (iteration, elapsed, squared error, phase)
    """

    def __init__(
        self,
        data: Trajectories,
        schedule: Sequence[Stage],
        *,
        bones: int,
        influences: int,
        rng: np.random.Generator,
        locked: Locked,
        given: Given,
        smoothness: WeightSmoothness | None = None,
        clock: Clock | None = None,
        rigid_joints: bool = False,
    ) -> None:
        self.rigid_joints = rigid_joints
        self.whole, self.data, self.schedule = data, data, tuple(schedule)
        self.chosen: NDArray[np.intp] | None = None
        self.bones, self.influences, self.rng = bones, influences, rng
        self.asked, self.given, self.smoothness = locked, given, smoothness
        self.objective = Objective(locked, smoothness)
        self.clock = clock or Clock()
        self.model: Model | None = None
        self.best: Model | None = None
        self.best_value = np.inf
        self.records: list[tuple[int, float, float, str]] = []
        self.stage: Stage | None = None
        self.iteration, self.converged, self.finished = 0, False, False
        self._done, self._work = 0.0, sum(stage.work for stage in schedule) or 1.0

    @property
    def locked(self) -> Locked:
        """Parts that the present step may not move, and the bone model that it uses."""
        locked = self.asked if self.chosen is None else self.asked.select_vertices(self.chosen)
        if self.stage is None or not self.stage.rigid:
            return locked
        return dataclasses.replace(locked, bone_model="rigid")

    @property
    def present_parts(self) -> Given:
        """Parts that the caller gave, restricted to the vertices of the present step."""
        if self.chosen is None or self.given.rest is None:
            return self.given
        return dataclasses.replace(self.given, rest=self.given.rest[self.chosen])

    @property
    def fraction(self) -> float:
        """Estimated fraction of the schedule's work that is done."""
        return min(1.0, self._done / self._work)

    @property
    def present(self) -> Model:
        """The model that a step starts from; every schedule begins with a start."""
        assert self.model is not None
        return self.model

    @property
    def best_model(self) -> Model:
        """The best model of the bones asked for; a run has one after its first steps."""
        assert self.best is not None
        return self.best

    def begin_with(self, model: Model) -> None:
        """Start from a copy of a model in place of a stage that makes one."""
        self.model = model.copy()
        if model.n_bones == self.bones:
            self.best, self.best_value = model.copy(), self.value(model)

    def drive(self, after_step: Callable[[str], str | None] | None = None) -> str | None:
        """Make steps until the schedule ends, or `after_step` gives a reason to stop.

        Parameters
        ----------
        after_step : callable, optional
            Called with the phase of each step that was made.

        Returns
        -------
        str or None
            The reason; None at the end of the schedule.
        """
        with serial_blas():
            for stage in self.schedule:
                for _ in self.steps_of(stage):
                    phase = self._record()
                    if self.best_value <= _EXACT * float(self.whole.x2.sum()):
                        self.converged = self.finished = True
                    reason = None if after_step is None else after_step(phase)
                    if reason is not None or self.finished:
                        return reason
        self.finished = True
        return None

    def make_steps(
        self,
        report: ProgressReport,
        *,
        save: Callable[[], None],
        part: tuple[float, float] = (0.0, 1.0),
    ) -> str:
        """Make steps until the schedule, the time limit or the caller ends them; says which.

        Parameters
        ----------
        report : ProgressReport
        save : callable
            Called after every step from the first model on; may write a checkpoint.
        part : (float, float)
            Fractions of the whole work that are done before and after this run.

        Raises
        ------
        Cancelled
            If the callback stopped the run before there was any model.
        """
        unit = self.whole.scale / math.sqrt(self.whole.n_frames * self.whole.n_vertices)

        def after_step(phase: str) -> str | None:
            rmse = unit * math.sqrt(self.best_value)
            _logger.debug("%s, iteration %d, rmse %.6g", phase, self.iteration, rmse)
            if self.best is not None:
                save()
            fraction = part[0] + (part[1] - part[0]) * self.fraction
            if report(phase, iteration=self.iteration, rmse=rmse, fraction=fraction):
                if self.best is None:
                    raise Cancelled("stopped by the callback before there was any model")
                return "cancelled"
            return "time limit" if self.best is not None and report.out_of_time else None

        return self.drive(after_step) or ("converged" if self.converged else "effort spent")

    @property
    def idle_bones(self) -> int:
        """Number of bones of the best model that could each be removed at no loss.

        In a tree only bones without children could.
        """
        wide = self.best_model.with_restarted_support()
        idle = bone_costs(self.whole, wide) <= _NO_LOSS * float(
            self.whole.importance @ self.whole.x2
        )
        if wide.tree is not None:
            idle[wide.tree.parents[wide.tree.non_roots]] = False
        return int(idle.sum())

    def steps_of(self, stage: Stage) -> Iterator[None]:
        """The steps of a stage, which count as work done."""
        self.stage, end = stage, self._done + stage.work
        for _ in stage.apply(self):
            self._done = min(self._done + stage.cost, end)
            yield
        self._done = end

    def value(self, model: Model) -> float:
        """The objective of a model."""
        return self.objective.value(self.data, model)

    def accept_if_lower(self, trial: Model) -> bool:
        """Continue from the trial if its objective is lower; True if it is."""
        lower = self.value(trial) < self.value(self.present)
        if lower:
            self.model = trial
        return lower

    def compress(self) -> None:
        """Continue with compressed trajectories: each frame a combination of a small basis."""
        self.whole = self.data = self.whole.compressed(self.bones)

    def take_sample(self, count: int) -> None:
        """Work on about `count` vertices from now on, evenly from still to wild ones.

        Where there are few more, on all of them as before.
        """
        n = self.whole.n_vertices
        if 2 * count < n:
            order = np.argsort(self.whole.x2, kind="stable")
            every = np.linspace(0, n - 1, count).round().astype(np.intp)
            self.chosen = np.sort(order[every])
            self.data = self.whole.select_vertices(self.chosen)

    def take_all(self) -> None:
        """Work on all vertices again."""
        self.data, self.chosen = self.whole, None

    def release(self) -> None:
        """Free the trajectories; no further step can be made."""
        self.take_all()
        self.whole = dataclasses.replace(self.whole, z=self.whole.z[:, :0].copy(), q=None)
        self.data = self.whole

    def _record(self) -> str:
        """Remember the present model if it is the best; returns the phase of its step."""
        stage, model = self.stage, self.model
        assert stage is not None
        if self.chosen is not None or model is None:
            return stage.phase
        if model.n_bones != self.bones or model.n_influences > self.influences:
            return stage.phase
        if self.rigid_joints and (model.tree is None or not model.tree.rigid):
            return stage.phase
        value = self.value(model)
        if value < self.best_value:
            self.best, self.best_value = model.copy(), value
            # the error alone, without the penalty that `value` may carry
            error = model.weighted_error(self.data)
            self.records.append((self.iteration, self.clock.elapsed, error, stage.phase))
        return stage.phase
