"""A decomposition in progress: the present model, the best one so far, and what a step may use.

A step is a function of a descent, such as :func:`~ssdr.search.steps.polish`, and a schedule a
function that calls steps one after another.  The best model with exactly the number of bones asked
for is kept apart from the model that the next step starts from.  The latter may have more bones,
more influences or, after a change, more error.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import functools
import inspect
import math
from collections.abc import Callable, Iterator
from typing import Any, Concatenate, ParamSpec

import numpy as np
from numpy.typing import NDArray

from ..parallel import serial_blas
from ..problem.problem import Initial
from ..progress import Monitor, Stop
from ..solver.alternation import bone_costs, repeat_alternation, vertex_step
from ..solver.model import Locked, Lowest, Model
from ..solver.objective import Objective, WeightSmoothness
from ..solver.trajectories import Trajectories
from .moves import polish_steps
from .vertex_sample import model_of_all

__all__ = ["ALTERNATIONS_OF_ALL", "Descent", "Schedule", "step"]

# Alternations on all vertices after a sample, and polish steps if the descent is stopped there.
ALTERNATIONS_OF_ALL, _STEPS_AFTER_STOP = 8, 8

# Objective, relative to the squared motion, below which only rounding errors are left.
_EXACT = 1e-30
# Rise of the objective, relative to the squared motion, that may be a rounding error: a bone whose
# removal costs less is idle.
_NO_LOSS = 1e-13
# Most repetitions of a step that are counted as work: more than that are rarely needed.
_EXPECTED = 60


@dataclasses.dataclass
class Work:
    """What is done of a schedule.

    Attributes
    ----------
    iteration : int
        Number of alternations and polish steps so far.
    done, expected : float
        Work that is done and that of the whole schedule, in alternations.
    plan : list of (phase, number of steps) or None
        Steps of a schedule while it is planned: they change nothing then.
    report : callable or None
        Called with the phase after each step.
    """

    iteration: int = 0
    done: float = 0.0
    expected: float = 1.0
    plan: list[tuple[str, int]] | None = None
    report: Callable[[str], None] | None = None


class Descent:
    """Decomposition in progress.

    Parameters
    ----------
    data : Trajectories
    bones, influences : int
    rng : numpy.random.Generator
    locked : Locked
        Parts that are kept, and the bone model.
    initial : Initial
        Parts that the caller gave, in the solver's space.
    smoothness : WeightSmoothness or None
        Penalty on the weights.
    monitor : Monitor, optional
    rigid_joints : bool
        Whether only models with bones attached at their joints are accepted as best.
    normals : bool
        Whether the last steps solve rest normals, too.

    Attributes
    ----------
    data : Trajectories
    few : Descent or None
        Descent on a sample of the vertices while one is in progress, with models of its own.
    model : Model
        Model that the next step starts from; it may have more bones than asked for.  There is none
        before the first step that makes one.
    best : Lowest
        Model of lowest objective so far with exactly the number of bones asked for.
    work : Work
        What is done of the schedule, shared with a descent on a sample.
    converged : bool
        True if the last step ended by its own stopping test.
    records : list of (iteration, elapsed, squared error, phase)
        One for each new best model.
    """

    model: Model

    def __init__(
        self,
        data: Trajectories,
        *,
        bones: int,
        influences: int,
        rng: np.random.Generator,
        locked: Locked,
        initial: Initial,
        smoothness: WeightSmoothness | None = None,
        monitor: Monitor | None = None,
        rigid_joints: bool = False,
        normals: bool = False,
    ) -> None:
        self.data = data
        self.few: Descent | None = None
        self._chosen: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
        self.bones, self.influences, self.rng = bones, influences, rng
        self.asked, self.initial, self.smoothness = locked, initial, smoothness
        self.rigid_joints, self.normals = rigid_joints, normals
        self.objective = Objective(locked, smoothness)
        self.monitor = monitor or Monitor()
        self.best = Lowest()
        self.records: list[tuple[int, float, float, str]] = []
        self.work, self.converged, self._rigid = Work(), False, False

    # --- what steps ask ------------------------------------------------------------------------

    @property
    def locked(self) -> Locked:
        """Parts that the present step keeps, and the bone model that it uses."""
        return dataclasses.replace(self.asked, bone_model="rigid") if self._rigid else self.asked

    @property
    def start_parts(self) -> Initial:
        """Parts for a new start."""
        return self.initial.beside_model()

    @property
    def iteration(self) -> int:
        """Number of alternations and polish steps so far."""
        return self.work.iteration

    @iteration.setter
    def iteration(self, count: int) -> None:
        self.work.iteration = count

    @property
    def planning(self) -> bool:
        """Whether a schedule is only planned: steps change nothing then."""
        return self.work.plan is not None

    @property
    def best_error(self) -> float:
        """Squared error of the best model, without the other factors of the objective."""
        return self.best.model.weighted_error(self.data) if self.best.exists else math.inf

    @property
    def removable_bones(self) -> int:
        """Number of bones that the best model could lose, one at a time, without more error.

        In a tree only bones without children count.
        """
        wide = self.best.model.with_restarted_support()
        energy = float(self.data.importance @ self.data.x2)
        removable = bone_costs(self.data, wide) <= _NO_LOSS * energy
        if wide.tree is not None:
            removable[wide.tree.parents[wide.tree.non_roots]] = False
        return int(removable.sum())

    def best_of_all(self) -> Lowest:
        """Best model so far of all vertices, made from a sample in progress if that is better."""
        best = copy.copy(self.best)
        if self.few is not None:
            model = self.of_all(self.few.best.model)
            polish_steps(self.data, model, _STEPS_AFTER_STOP, self.locked)
            best.offer(model, self.value(model))
        return best

    def sample(self, chosen: NDArray[np.intp], *, free: bool) -> Descent:
        """A descent on the chosen vertices that starts from the present and the best model.

        Its rest pose is free, or else keeps to a coarse surface.
        """
        few = copy.copy(self)
        few.data, few.asked = self.data.select_vertices(chosen), self.asked.select_vertices(chosen)
        if self.data.surface is not None and not free:
            few.data = dataclasses.replace(few.data, surface=self.data.surface.sampled(chosen))
        few.initial, few.records = self.start_parts.of_vertices(chosen), []
        few.smoothness, few.objective = None, Objective(few.asked)
        if not self.planning:
            few.model = self.model.select_vertices(chosen)
            few.set_best(self.best.model.select_vertices(chosen))
            self.few, self._chosen = few, chosen
        return few

    def unpenalised(self) -> Descent:
        """A descent of its own on the same data, without the penalty on the weights."""
        bare = copy.copy(self)
        bare.smoothness, bare.objective, bare.records = None, Objective(self.asked), []
        bare.best = Lowest()
        return bare

    def of_all(self, few: Model) -> Model:
        """Model of all vertices made from one of the sample in progress, by eight alternations."""
        parts, locked = self.start_parts, self.locked
        rest = parts.first_pose(self.data)
        model = model_of_all(few, rest, self._chosen)
        if parts.rest is not None:
            model.rest = rest
        vertex_step(self.data, model, locked=locked)
        repeat_alternation(self.data, model, ALTERNATIONS_OF_ALL, locked)
        return model

    def value(self, model: Model) -> float:
        """Objective of a model."""
        return self.objective.value(self.data, model)

    def below(self, limit: float, *, expected: bool) -> bool:
        """Whether the present objective is below `limit`; `expected` while steps are planned."""
        return expected if self.planning else self.value(self.model) < limit

    # --- what steps change ---------------------------------------------------------------------

    def begin_with(self, model: Model) -> None:
        """Take a copy of `model` as the present one and, with the bones asked for, as the best."""
        self.model = model.copy()
        if model.n_bones == self.bones:
            self.set_best(model)

    def set_best(self, model: Model) -> None:
        """Take a copy of `model` as the best, whatever its objective."""
        self.best = Lowest()
        self.best.offer(model, self.value(model))

    def drop_tree(self) -> None:
        """Remove the tree from the present model, so that its bones move freely."""
        if not self.planning:
            self.model = dataclasses.replace(self.model.copy(), tree=None)

    @contextlib.contextmanager
    def rigid_bones(self) -> Iterator[None]:
        """Use rigid bones, even if another bone model was asked for."""
        self._rigid = True
        try:
            yield
        finally:
            self._rigid = False

    def release(self) -> None:
        """Free the memory of the trajectories, after which no step can be made."""
        empty = self.data.z[:, :0].copy()
        self.data = dataclasses.replace(self.data, z=empty, q=None, normals=None)

    # --- schedules -----------------------------------------------------------------------------

    def follow(self, schedule: Schedule, report: Callable[[str], None] | None = None) -> str:
        """Follow a schedule to its end.

        Parameters
        ----------
        schedule : Schedule
        report : callable, optional
            Called with the phase of each step that was made; it raises :class:`~ssdr.progress.Stop`
            to end the descent.

        Returns
        -------
        str
            Reason of the stop; "converged" or "effort spent" if there was none.
        """
        work = self.work
        with serial_blas():
            work.plan, work.done = [], 0.0
            schedule(self)
            work.plan, work.expected, work.done = None, work.done or 1.0, 0.0
            work.report = report
            try:
                schedule(self)
            except Stop as stop:
                if self.few is not None:
                    self.model, self.few = self.best_of_all().model, None
                    self._remember_best("all vertices")
                return str(stop)
        return "converged" if self.converged else "effort spent"

    @property
    def fraction(self) -> float:
        """Estimated fraction of the schedule's work that is done."""
        return min(1.0, self.work.done / self.work.expected)

    def after_step(self, phase: str) -> None:
        """Remember the best model and report the step.

        Raises
        ------
        Stop
            If the report asks to stop, or no error is left.
        """
        self._remember_best(phase)
        exact = self.best.value <= _EXACT * float(self.data.x2.sum())
        self.converged |= exact
        if self.work.report is not None:
            self.work.report(phase)
        if exact:
            raise Stop("converged")

    def _remember_best(self, phase: str) -> None:
        if not hasattr(self, "model"):
            return
        model = self.model
        if model.n_bones != self.bones or model.n_influences > self.influences:
            return
        if self.rigid_joints and (model.tree is None or not model.tree.rigid):
            return
        if self.best.offer(model, self.value(model)):
            # the error alone, without the penalty that `value` may carry
            error = model.weighted_error(self.data)
            self.records.append((self.iteration, self.monitor.elapsed, error, phase))


Schedule = Callable[[Descent], None]
P = ParamSpec("P")
Steps = Callable[Concatenate[Descent, P], Iterator[None]]


def step(
    phase: str, *, cost: float = 1.0
) -> Callable[[Steps[P]], Callable[Concatenate[Descent, P], None]]:
    """Decorator for a generator that changes the model of a descent and yields after each step.

    Parameters
    ----------
    phase : str
        Name of the step in reports.
    cost : float
        Time of a step, in alternations; used only to estimate the time left.  The number of steps
        is the argument `steps` of the function, or else 1.
    """

    def decorate(generator: Steps[P]) -> Callable[Concatenate[Descent, P], None]:
        usual = inspect.signature(generator).parameters.get("steps")

        @functools.wraps(generator)
        def make_steps(d: Descent, /, *args: P.args, **options: P.kwargs) -> None:
            count: Any = options.get("steps", 1 if usual is None else usual.default)
            work = d.work
            end = work.done + cost * min(count, _EXPECTED)
            if work.plan is not None:
                work.plan.append((phase, count))
            for _ in () if work.plan is not None else generator(d, *args, **options):
                work.done = min(work.done + cost, end)
                d.after_step(phase)
            work.done = end

        return make_steps

    return decorate
