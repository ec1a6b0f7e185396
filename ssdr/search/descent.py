"""A decomposition in progress: the present model, the best one so far, and what a step may use.

A step is a function of a descent, such as :func:`~ssdr.search.steps.polish`, and a schedule a
function that calls steps one after another.  The best model with exactly the number of bones asked
for is kept apart from the model that the next step starts from.  The latter may have more bones,
more influences or, after a change, more error.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import math
from collections.abc import Callable, Iterator
from typing import Any, Concatenate, ParamSpec

import numpy as np
from numpy.typing import NDArray

from ..parallel import serial_blas
from ..problem.initial import Initial
from ..progress import Monitor, Stop
from ..solver.alternation import bone_costs
from ..solver.model import Locked, Model
from ..solver.objective import Objective
from ..solver.smoothness import WeightSmoothness
from ..solver.trajectories import Trajectories

__all__ = ["Descent", "Schedule", "step"]

# Objective, relative to the squared motion, below which only rounding errors are left.
_EXACT = 1e-30
# Rise of the objective, relative to the squared motion, that may be a rounding error: a bone whose
# removal costs less is idle.
_NO_LOSS = 1e-13
# Most repetitions of a step that are counted as work: more than that are rarely needed.
_EXPECTED = 60


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
    full : Trajectories
        Trajectories of all vertices.
    data : Trajectories
        Trajectories that the present step works on: of all vertices, or of a sample of them.
    chosen : (n,) int array or None
        Indices of the vertices of that sample; None if all vertices are used.
    model : Model
        Model that the next step starts from; it may have more bones than asked for.  There is none
        before the first step that makes one.
    best : Model or None
        Model of lowest objective so far with exactly the number of bones asked for.
    best_value : float
        Objective of `best`.
    plan : list of (phase, number of steps) or None
        Steps of a schedule while it is planned: they change nothing then.
    done : float
        Work of the schedule that is done, in alternations.
    iteration : int
        Number of alternations and polish steps so far.
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
        self.full = self.data = data
        self.chosen: NDArray[np.intp] | None = None
        self.bones, self.influences, self.rng = bones, influences, rng
        self.asked, self.initial, self.smoothness = locked, initial, smoothness
        self.rigid_joints, self.normals = rigid_joints, normals
        self.objective = Objective(locked, smoothness)
        self.monitor = monitor or Monitor()
        self.best: Model | None = None
        self.best_value = np.inf
        self.records: list[tuple[int, float, float, str]] = []
        self.iteration, self.converged = 0, False
        self.plan: list[tuple[str, int]] | None = None
        self._rigid, self.done, self._work = False, 0.0, 1.0
        self._report: Callable[[str], None] | None = None

    # --- what steps ask ------------------------------------------------------------------------

    @property
    def locked(self) -> Locked:
        """Parts that the present step keeps, and the bone model that it uses."""
        locked = self.asked if self.chosen is None else self.asked.select_vertices(self.chosen)
        return dataclasses.replace(locked, bone_model="rigid") if self._rigid else locked

    @property
    def start_parts(self) -> Initial:
        """Parts for a new start, restricted to the vertices of the present step."""
        parts = self.initial.beside_model()
        if self.chosen is None or parts.rest is None:
            return parts
        return dataclasses.replace(parts, rest=parts.rest[self.chosen])

    @property
    def best_model(self) -> Model:
        """Best model with the number of bones asked for; it exists once a step has made one."""
        assert self.best is not None
        return self.best

    @property
    def best_error(self) -> float:
        """Squared error of the best model, without the other factors of the objective."""
        return math.inf if self.best is None else self.best.weighted_error(self.full)

    @property
    def removable_bones(self) -> int:
        """Number of bones that the best model could lose, one at a time, without more error.

        In a tree only bones without children count.
        """
        wide = self.best_model.with_restarted_support()
        removable = bone_costs(self.full, wide) <= _NO_LOSS * float(
            self.full.importance @ self.full.x2
        )
        if wide.tree is not None:
            removable[wide.tree.parents[wide.tree.non_roots]] = False
        return int(removable.sum())

    def value(self, model: Model) -> float:
        """Objective of a model on the vertices that the present step works on."""
        return self.objective.value(self.data, model)

    def below(self, limit: float, *, expected: bool) -> bool:
        """Whether the present objective is below `limit`; `expected` while steps are planned."""
        return expected if self.plan is not None else self.value(self.model) < limit

    # --- what steps change ---------------------------------------------------------------------

    def begin_with(self, model: Model) -> None:
        """Take a copy of `model` as the present one and, with the bones asked for, as the best."""
        self.model = model.copy()
        if model.n_bones == self.bones:
            self.best, self.best_value = model.copy(), self.value(model)

    def keep_present(self) -> None:
        """Take the present model as the best, whatever its objective."""
        self.best, self.best_value = self.model.copy(), self.value(self.model)

    def drop_tree(self) -> None:
        """Remove the tree from the present model, so that its bones move freely."""
        if self.plan is None:
            self.model = dataclasses.replace(self.model.copy(), tree=None)

    def accept_if_lower(self, trial: Model) -> bool:
        """Continue from `trial` if its objective is lower; return whether it is."""
        lower = self.value(trial) < self.value(self.model)
        if lower:
            self.model = trial
        return lower

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
        empty = self.full.z[:, :0].copy()
        self.full = dataclasses.replace(self.full, z=empty, q=None, normals=None)
        self.data, self.chosen = self.full, None

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
        with serial_blas():
            self.plan, self.done = [], 0.0
            schedule(self)
            self.plan, self._work, self.done = None, self.done or 1.0, 0.0
            self._report = report
            try:
                schedule(self)
            except Stop as stop:
                return str(stop)
        return "converged" if self.converged else "effort spent"

    @property
    def fraction(self) -> float:
        """Estimated fraction of the schedule's work that is done."""
        return min(1.0, self.done / self._work)

    def after_step(self, phase: str) -> None:
        """Remember the best model and report the step.

        Raises
        ------
        Stop
            If the report asks to stop, or no error is left.
        """
        self._remember_best(phase)
        exact = self.best_value <= _EXACT * float(self.full.x2.sum())
        self.converged |= exact
        if self._report is not None:
            self._report(phase)
        if exact:
            raise Stop("converged")

    def _remember_best(self, phase: str) -> None:
        if self.chosen is not None or not hasattr(self, "model"):
            return
        model = self.model
        if model.n_bones != self.bones or model.n_influences > self.influences:
            return
        if self.rigid_joints and (model.tree is None or not model.tree.rigid):
            return
        value = self.value(model)
        if value < self.best_value:
            self.best, self.best_value = model.copy(), value
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
            end = d.done + cost * min(count, _EXPECTED)
            if d.plan is not None:
                d.plan.append((phase, count))
            for _ in () if d.plan is not None else generator(d, *args, **options):
                d.done = min(d.done + cost, end)
                d.after_step(phase)
            d.done = end

        return make_steps

    return decorate
