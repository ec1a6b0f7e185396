"""A decomposition in progress, or descent: its data, its present model, and its best one so far.

A step is a function of a descent, such as :func:`~ssdr.search.steps.polish`, and a schedule a
function that calls steps one after another.  The next step starts from the present model, which may
have more bones, more influences or, after a change, more error than the best model.  The latter has
exactly the requested number of bones.

:meth:`Descent.follow` runs a schedule twice, first to add up the work of its steps for the estimate
of the time left.  What a schedule does outside steps must not touch the model then.
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
from scipy.spatial import cKDTree

from ..common.parallel import serial_blas
from ..solver.alternation import bone_costs, repeat_alternation, vertex_step
from ..solver.initialization import by_motion, with_rest_normals
from ..solver.model import Constraints, Lowest, Model
from ..solver.objective import Objective, WeightSmoothness
from ..solver.trajectories import Trajectories
from .problem import Initial
from .progress import Monitor, Stop

# Objective, relative to the squared motion, below which only rounding errors are left.
_EXACT = 1e-30
# Rise of the objective, relative to the squared motion, that may be a rounding error: a bone whose
# removal costs less is idle.
_NO_LOSS = 1e-13
# Most repetitions of a step that are counted as work: more than that are rarely needed.
_EXPECTED = 60


@dataclasses.dataclass
class Work:
    """Progress of a schedule.

    Attributes
    ----------
    iteration : int
        Number of alternations and polish steps so far.
    done, expected : float
        Work done so far and work of the whole schedule, in units of one alternation.
    plan : list of (phase, number of steps) or None
        While not None, the schedule runs only to list its steps: no step changes anything, and
        there may be no model.
    report : callable or None
        Called with the phase after each step.
    """

    iteration: int = 0
    done: float = 0.0
    expected: float = 1.0
    plan: list[tuple[str, int]] | None = None
    report: Callable[[str], None] | None = None


@dataclasses.dataclass(eq=False, repr=False)
class Descent:
    """Decomposition in progress.

    Parameters
    ----------
    data : Trajectories
    bones, influences : int
    rng : numpy.random.Generator
    constraints : Constraints
        Parts that must not change, and the bone model.
    initial : Initial
        Parts that the caller gave, in the solver's space.
    smoothness : WeightSmoothness or None
        Penalty on the weights.
    monitor : Monitor, optional
    rigid_joints : bool
        Whether only models with bones attached at their joints are accepted as best.
    normals : float or None
        Length, in the mesh's units, below which errors of positions do not count against normals;
        None if the last steps do not solve rest normals.

    Attributes
    ----------
    data : Trajectories
    constraints : Constraints
        Parts that must not change, and the bone model of the present step.
    few : Descent or None
        Descent on a sample of the vertices, with models of its own; None unless it is in progress.
    model : Model
        The present model, from which the next step starts; it may have more than `bones` bones.
        The attribute does not exist before the first step that makes a model.
    best : Lowest
        Model of lowest objective so far with exactly `bones` bones.
    work : Work
        Progress of the schedule, shared with a descent on a sample.
    converged : bool
        True if the last step ended by its own stopping test.
    records : list of (iteration, elapsed, squared error, phase)
        One for each new best model.
    """

    data: Trajectories
    _: dataclasses.KW_ONLY
    bones: int
    influences: int
    rng: np.random.Generator
    constraints: Constraints
    initial: Initial
    smoothness: WeightSmoothness | None = None
    monitor: Monitor = dataclasses.field(default_factory=Monitor)
    rigid_joints: bool = False
    normals: float | None = None
    model: Model = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        self.few: Descent | None = None
        self._chosen: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
        self.objective = Objective(self.constraints, self.smoothness)
        self.best, self.work, self.converged = Lowest(), Work(), False
        self.records: list[tuple[int, float, float, str]] = []

    # --- what steps ask ------------------------------------------------------------------------

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
        """Number of bones of the best model that could each be removed without raising the error.

        In a tree only bones without children count.
        """
        wide = self.best.model.with_restarted_support()
        energy = float(self.data.importance @ self.data.x2)
        removable = bone_costs(self.data, wide) <= _NO_LOSS * energy
        if wide.tree is not None:
            removable[wide.tree.parents[wide.tree.non_roots]] = False
        return int(removable.sum())

    def best_of_all(self) -> Lowest:
        """Best model of all vertices so far.

        If a sample is in progress, its best model is fitted to all vertices and taken if better.
        """
        best = copy.copy(self.best)
        if self.few is not None:
            model = self.of_all(self.few.best.model, 1)
            best.offer(model, self.value(model))
        return best

    def sample(self, count: int, *, free: bool) -> Descent:
        """Begin a descent on `count` vertices from the present model, and return it.

        Its rest pose is free if `free`; otherwise it is held by a coarse surface.
        """
        few, planned = copy.copy(self), self.planning
        chosen = np.arange(count) if planned else motion_sample(self.data, count)
        few.data = self.data.select_vertices(chosen)
        few.constraints = self.constraints.select_vertices(chosen)
        if self.data.surface is not None and not free and not planned:
            few.data = dataclasses.replace(few.data, surface=self.data.surface.sampled(chosen))
        few.initial, few.records = self.initial.beside_model().of_vertices(chosen), []
        few.smoothness, few.objective = None, Objective(few.constraints)
        if not planned:
            few.begin_with(self.model.select_vertices(chosen).without_normals())
            self.few, self._chosen = few, chosen
        return few

    def unpenalised(self) -> Descent:
        """A separate descent on the same data, with no penalty on the weights and no best model."""
        bare = copy.copy(self)
        bare.smoothness, bare.objective, bare.records = None, Objective(self.constraints), []
        bare.best = Lowest()
        return bare

    def of_all(self, few: Model, alternations: int) -> Model:
        """Model of all vertices, made by alternations from `few`, a model of the sample.

        Each vertex starts with the weights of the nearest vertex of the sample, and with the offset
        from it that it has in the first pose.  If the sample has all vertices, nothing changes.
        """
        if len(few.rest) == self.data.n_vertices:
            return few.copy() if self.data.normals is None else with_rest_normals(self.data, few)
        parts, constraints = self.initial.beside_model(), self.constraints
        rest = parts.first_pose(self.data)
        nearest = np.asarray(cKDTree(rest[self._chosen]).query(rest)[1])
        model = few.select_vertices(nearest)
        model.rest = model.rest + rest - rest[self._chosen][nearest]
        model.restart_support()
        if parts.rest is not None:
            model.rest = rest
        if self.data.normals is not None:
            model = with_rest_normals(self.data, model)
        vertex_step(self.data, model, constraints=constraints)
        repeat_alternation(self.data, model, alternations, constraints)
        return model

    def value(self, model: Model) -> float:
        """Objective of a model."""
        return self.objective.value(self.data, model)

    # --- what steps change ---------------------------------------------------------------------

    def begin_with(self, model: Model) -> None:
        """Make a copy of `model` the present model.

        If it has the requested number of bones, it also becomes the best, whatever its objective.
        """
        self.model = model.copy()
        if model.n_bones == self.bones:
            self.set_best(model)

    def set_best(self, model: Model) -> None:
        """Make a copy of `model` the best model, whatever its objective."""
        self.best = Lowest()
        self.best.offer(model, self.value(model))

    @contextlib.contextmanager
    def rigid_bones(self) -> Iterator[None]:
        """Context in which steps use rigid bones, whatever bone model was requested."""
        requested = self.constraints
        self.constraints = dataclasses.replace(requested, bone_model="rigid")
        try:
            yield
        finally:
            self.constraints = requested

    # --- schedules -----------------------------------------------------------------------------

    def follow(self, schedule: Schedule, report: Callable[[str], None] | None = None) -> str:
        """Follow a schedule to its end.

        Parameters
        ----------
        schedule : Schedule
        report : callable, optional
            Called with the phase after each step; it raises `Stop` to end
            the descent.

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
        """Update the best model and report the step.

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
            self.records.append((self.work.iteration, self.monitor.elapsed, error, phase))


Schedule = Callable[[Descent], None]
P = ParamSpec("P")
Steps = Callable[Concatenate[Descent, P], Iterator[None]]


def step(
    phase: str, *, cost: float = 1.0
) -> Callable[[Steps[P]], Callable[Concatenate[Descent, P], None]]:
    """Decorator that turns a generator into a function that makes all of its rounds.

    The generator changes the model of a descent and yields after each round; then the best model
    is updated and the round reported.  While a schedule is only planned, no round is made.

    Parameters
    ----------
    phase : str
        Name of the step in reports.
    cost : float
        Time of a round in units of one alternation; used only to estimate the time left.  The
        number of rounds is the argument `steps` of the function or, if it has none, 1.
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


LEAST, MOST = 48, 128  # bounds of the number of vertices of a sample, per bone


def motion_sample(data: Trajectories, count: int) -> NDArray[np.intp]:
    """Indices of `count` vertices, ascending, evenly spaced in the order of :func:`by_motion`."""
    every = np.linspace(0, data.n_vertices - 1, count).round().astype(np.intp)
    return np.sort(by_motion(data)[every])
