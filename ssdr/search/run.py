"""Runs: a run goes through the stages of a schedule and remembers the best model.

The best model with exactly the number of bones asked for is kept apart from the model that the next
step starts from.  The latter may have more bones, more influences or, after a change, more error.
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
from ..solver.initialization import by_motion
from ..solver.model import Locked, Model
from ..solver.objective import Objective
from ..solver.rest_normals import with_rest_normals
from ..solver.smoothness import WeightSmoothness
from ..solver.trajectories import Trajectories
from .given import Given
from .progress import Clock, ProgressReport

__all__ = ["Beside", "Lowest", "Run", "Schedule", "Stage"]

_logger = logging.getLogger(__name__)
# Objective, relative to the squared motion, below which only rounding errors are left.
_EXACT = 1e-30
# Rise of the objective, relative to the squared motion, that may be a rounding error: a bone whose
# removal costs less is idle.
_NO_LOSS = 1e-13


@dataclasses.dataclass(frozen=True, kw_only=True)
class Stage(ABC):
    """One entry of a schedule: a step that is repeated while it improves the model.

    Attributes
    ----------
    steps : int
        Most repetitions.
    cost : float
        Time of a step, in alternations; used only to estimate the time left.
    rigid : bool
        Whether to use rigid bones even if another bone model was asked for.
    """

    phase: ClassVar[str]
    steps: int = 1
    cost: float = 1.0
    rigid: bool = False

    @property
    def work(self) -> float:
        """Expected time of the stage, in alternations."""
        return self.steps * self.cost

    @abstractmethod
    def apply(self, run: Run) -> Iterator[None]:
        """Make the steps of the stage on the model of `run`; yield after each."""


Schedule = tuple[Stage, ...]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Lowest(Stage):
    """Run several schedules, each from its own start; continue from the model of least objective.

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


@dataclasses.dataclass(frozen=True, kw_only=True)
class Beside(Stage):
    """Run a schedule from another start; keep the best model before it unless errors become less.

    Attributes
    ----------
    start : Schedule
    """

    phase: ClassVar[str] = "beside"
    cost: float = 0.0
    start: Schedule

    @property
    def work(self) -> float:
        return sum(stage.work for stage in self.start)

    def apply(self, run: Run) -> Iterator[None]:
        before, value, known = run.best_model.copy(), run.best_value, len(run.records)
        for stage in self.start:
            yield from run.steps_of(stage)
        if run.best_model.weighted_error(run.whole) > before.weighted_error(run.whole):
            run.best, run.best_value = before, value
            del run.records[known:]


class Run:
    """Decomposition in progress.

    Parameters
    ----------
    data : Trajectories
    schedule : sequence of Stage
    bones, influences : int
    rng : numpy.random.Generator
    locked : Locked
        Parts that are kept, and the bone model.
    given : Given
        Parts that the caller gave, in the solver's space.
    smoothness : WeightSmoothness or None
        Penalty on the weights.
    clock : Clock, optional
    rigid_joints : bool
        Whether only models with bones attached at their joints are accepted as best.

    Attributes
    ----------
    whole : Trajectories
        Trajectories of all vertices.
    data : Trajectories
        Trajectories that the present step works on: of all vertices, or of a sample of them.
    chosen : (n,) int array or None
        Indices of the vertices of that sample; None if all vertices are used.
    model : Model or None
        Model that the next step starts from; it may have more bones than asked for.
    best : Model or None
        Model of lowest objective so far with exactly the number of bones asked for.
    best_value : float
        Objective of `best`.
    stage : Stage or None
        Stage whose steps are being made.
    iteration : int
        Number of alternations and polish steps so far.
    converged : bool
        True if the last stage ended by its own stopping test.
    finished : bool
        True once no stage is left.
    records : list of (iteration, elapsed, squared error, phase)
        One for each new best model.
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
        """Parts that the present step keeps, and the bone model that it uses."""
        locked = self.asked if self.chosen is None else self.asked.select_vertices(self.chosen)
        if self.stage is None or not self.stage.rigid:
            return locked
        return dataclasses.replace(locked, bone_model="rigid")

    @property
    def present_parts(self) -> Given:
        """Parts for a new start, restricted to the vertices of the present step."""
        given = self.given.beside_model()
        if self.chosen is None or given.rest is None:
            return given
        return dataclasses.replace(given, rest=given.rest[self.chosen])

    @property
    def fraction(self) -> float:
        """Estimated fraction of the schedule's work that is done."""
        return min(1.0, self._done / self._work)

    @property
    def present(self) -> Model:
        """Model that a step starts from; it exists because every schedule begins by making one."""
        assert self.model is not None
        return self.model

    @property
    def best_model(self) -> Model:
        """Best model with the number of bones asked for; it exists once a step has made one."""
        assert self.best is not None
        return self.best

    @property
    def best_error(self) -> float:
        """Squared error of the best model, without the other factors of the objective."""
        return math.inf if self.best is None else self.best.weighted_error(self.whole)

    def begin_with(self, model: Model) -> None:
        """Start from a copy of `model` instead of a stage that makes a model."""
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
            Reason that `after_step` gave; None if it gave none.
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
        """Make steps until the schedule, the time limit or the callback ends the run.

        Parameters
        ----------
        report : ProgressReport
        save : callable
            Called after every step once there is a best model; it may write a checkpoint.
        part : (float, float)
            Fractions of the whole work that are done before and after this run.

        Returns
        -------
        str
            "converged", "effort spent", "time limit" or "cancelled".

        Raises
        ------
        Cancelled
            If the callback stopped the run before there was any model.
        """
        unit = self.whole.scale / math.sqrt(self.whole.n_frames * self.whole.n_vertices)

        def after_step(phase: str) -> str | None:
            rmse = unit * math.sqrt(self.best_error)
            fraction = part[0] + (part[1] - part[0]) * self.fraction
            said = phase, self.iteration, rmse, 100 * fraction
            _logger.debug("%s, iteration %d, rmse %.6g, %.0f %% done", *said)
            if self.best is not None:
                save()
            if report(phase, iteration=self.iteration, rmse=rmse, fraction=fraction):
                if self.best is None:
                    raise Cancelled("stopped by the callback before there was any model")
                return "cancelled"
            return "time limit" if self.best is not None and report.out_of_time else None

        return self.drive(after_step) or ("converged" if self.converged else "effort spent")

    @property
    def idle_bones(self) -> int:
        """Number of bones that the best model could lose, one at a time, without more error.

        In a tree only bones without children count.
        """
        wide = self.best_model.with_restarted_support()
        idle = bone_costs(self.whole, wide) <= _NO_LOSS * float(
            self.whole.importance @ self.whole.x2
        )
        if wide.tree is not None:
            idle[wide.tree.parents[wide.tree.non_roots]] = False
        return int(idle.sum())

    def steps_of(self, stage: Stage) -> Iterator[None]:
        """Make the steps of a stage, yield after each, and count them as work done."""
        self.stage, end = stage, self._done + stage.work
        for _ in stage.apply(self):
            self._done = min(self._done + stage.cost, end)
            yield
        self._done = end

    def value(self, model: Model) -> float:
        """Objective of a model on the vertices that the present step works on."""
        return self.objective.value(self.data, model)

    def accept_if_lower(self, trial: Model) -> bool:
        """Continue from `trial` if its objective is lower; return whether it is."""
        lower = self.value(trial) < self.value(self.present)
        if lower:
            self.model = trial
        return lower

    def compress(self) -> None:
        """Continue with trajectories that are compressed to as few columns as the bones need."""
        self.whole = self.data = self.whole.compressed(self.bones)

    def solve_normals(self) -> None:
        """Solve rest normals, too, from now on; they are part of the objective."""
        self.whole = self.data = self.whole.with_normals()
        self.model = with_rest_normals(self.data, self.present)
        if self.best is not None:
            self.best = with_rest_normals(self.data, self.best)
            self.best_value = self.value(self.best)

    def stiffen(self, faces: NDArray[np.int32]) -> None:
        """Count the edges of some triangles of the rest pose ten times as much from now on."""
        assert self.whole.surface is not None
        surface = self.whole.surface.stiffened(faces)
        self.whole = self.data = dataclasses.replace(self.whole, surface=surface)

    def keep_present(self) -> None:
        """Take the present model as the best, whatever its objective."""
        self.best, self.best_value = self.present.copy(), self.value(self.present)

    def take_sample(self, count: int) -> None:
        """Work on a sample of `count` vertices from now on, spread evenly over the range of motion.

        If the mesh has at most twice as many vertices, no sample is taken.
        """
        n = self.whole.n_vertices
        if 2 * count < n:
            order = by_motion(self.whole)
            every = np.linspace(0, n - 1, count).round().astype(np.intp)
            self.chosen = np.sort(order[every])
            self.data = self.whole.select_vertices(self.chosen)

    def take_all(self) -> None:
        """Work on all vertices again."""
        self.data, self.chosen = self.whole, None

    def release(self) -> None:
        """Free the memory of the trajectories, after which no step can be made."""
        self.take_all()
        self.whole = dataclasses.replace(
            self.whole, z=self.whole.z[:, :0].copy(), q=None, normals=None
        )
        self.data = self.whole

    def _record(self) -> str:
        """Remember the present model if it is the best; return the phase of the present stage."""
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
