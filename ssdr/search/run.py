"""A decomposition under way: a run through the stages of a schedule.

It is at all times between two small steps and can be stopped, saved and resumed there.  The
best model of exactly the bones asked for is remembered apart from the one that the next step
starts from, which may have more bones, more influences or, after a change, more error.
"""

from __future__ import annotations

import copy
import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..parallel import serial_blas
from ..solver.conjugate_gradients import Recycled
from ..solver.gauss_newton import GaussNewton
from ..solver.model import Fixed, Model
from ..solver.objective import Objective
from ..solver.smoothness import WeightSmoothness
from ..solver.trajectories import Trajectories
from .prescribed import Prescribed
from .progress import Clock
from .state import number, numbers, whole

__all__ = ["Memory", "Run", "Stage"]

# of the squared motion: an objective below is rounding alone, and nothing is left to gain
_EXACT = 1e-30


@dataclasses.dataclass(frozen=True, kw_only=True)
class Stage(ABC):
    """One entry of a schedule: a step that is repeated until it does not pay, or often enough.

    Attributes
    ----------
    steps : int
        At most.
    cost : float
        Of a step, in alternations: for the time left alone.
    branch : bool
        Draws from a copy of the random generator, made where the branch starts: a start that
        is given up leaves no trace in what comes after it.
    rigid : bool
        With rigid bones, whatever kind was asked for.
    """

    phase: ClassVar[str]
    changes: ClassVar[int] = 0  # kinds of change that it takes turns with
    steps: int = 1
    cost: float = 1.0
    branch: bool = False
    rigid: bool = False

    @property
    def expected_steps(self) -> int:
        return self.steps

    @abstractmethod
    def step(self, run: Run) -> bool:
        """One small step; whether the stage is over."""

    def prepare(self, run: Run) -> None:  # noqa: B027  # most stages change no data
        """Change the data as the whole stage does, for a run that is taken up behind it."""


@dataclasses.dataclass
class Memory:
    """What a stage remembers from step to step.

    Attributes
    ----------
    count : int
        Steps so far.
    failures : int
        Steps in a row that did not pay.
    recent : list of float
        Objectives of the last steps of a polish.
    track : list of float
        Objective before a search and after each of its tries.
    turns, misses : list of int
        Of each kind of change of a search: the try at which it had its last turn, and the
        failures since it paid.
    damping : float or None
        Of the polish.
    """

    count: int = 0
    failures: int = 0
    recent: list[float] = dataclasses.field(default_factory=list)
    track: list[float] = dataclasses.field(default_factory=list)
    turns: list[int] = dataclasses.field(default_factory=list)
    misses: list[int] = dataclasses.field(default_factory=list)
    damping: float | None = None


class Run:
    """A decomposition under way.

    Parameters
    ----------
    data : Trajectories
    schedule : sequence of Stage
    bones, influences : int
    rng : numpy.random.Generator
    fixed : Fixed
        What stays as it is, and what bones may do.
    prescribed : Prescribed
        Parts that the caller handed over, in the solver's space.
    smoothness : WeightSmoothness or None
        Penalty on the weights.
    clock : Clock, optional
    rigid_joints : bool
        Whether only models whose bones hang on joints count.

    Attributes
    ----------
    whole : Trajectories
        Of all vertices.
    data : Trajectories
        What the present step works on: all vertices, or a sample of them.
    chosen : (n,) int array or None
        The vertices of that sample.
    model : Model or None
        What the next step starts from; may have more bones than asked for.
    best : Model or None
        Lowest objective so far with exactly the bones asked for.
    best_value : float
    aside : Model or None
        The lowest of several starts so far, while others are made.
    iteration : int
        Alternations and polish steps so far.
    converged : bool
        Whether the last stage ended by its own stopping test.
    memory : Memory
        Of the present stage.
    leader : list of float
        Track of the search that ended lowest.
    recycled : Recycled or None
        What the last step of the present polish hands on to the next.
    polish : GaussNewton or None
        Of the present stage; its factors last from step to step.
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
        fixed: Fixed,
        prescribed: Prescribed,
        smoothness: WeightSmoothness | None = None,
        clock: Clock | None = None,
        rigid_joints: bool = False,
    ) -> None:
        self.rigid_joints = rigid_joints
        self.whole, self.data, self.schedule = data, data, tuple(schedule)
        self.chosen: NDArray[np.intp] | None = None
        self.bones, self.influences, self.rng = bones, influences, rng
        self.asked, self.prescribed, self.smoothness = fixed, prescribed, smoothness
        self.clock = clock or Clock()
        self.model: Model | None = None
        self.best: Model | None = None
        self.best_value = np.inf
        self.aside: Model | None = None
        self.records: list[tuple[int, float, float, str]] = []
        self.position, self.iteration, self.converged = 0, 0, False
        self.branch_rng = rng
        self.leader: list[float] = []
        self.memory = Memory()
        self.polish: GaussNewton | None = None
        self.recycled: Recycled | None = None

    @property
    def finished(self) -> bool:
        return self.position >= len(self.schedule)

    @property
    def stage(self) -> Stage | None:
        return None if self.finished else self.schedule[self.position]

    @property
    def phase(self) -> str:
        return "done" if self.stage is None else self.stage.phase

    @property
    def fixed(self) -> Fixed:
        """What the present step may move, and how."""
        fixed = self.asked if self.chosen is None else self.asked.select_vertices(self.chosen)
        if self.stage is None or not self.stage.rigid:
            return fixed
        return dataclasses.replace(fixed, bone_model="rigid")

    @property
    def present_parts(self) -> Prescribed:
        """What the caller handed over, of the vertices that the present step works on."""
        if self.chosen is None or self.prescribed.rest is None:
            return self.prescribed
        return dataclasses.replace(self.prescribed, rest=self.prescribed.rest[self.chosen])

    @property
    def generator(self) -> np.random.Generator:
        """Where the present stage draws from."""
        return self.branch_rng if self.stage is not None and self.stage.branch else self.rng

    @property
    def fraction(self) -> float:
        """Fraction of the schedule's work that is done, by its estimated cost."""
        done = total = 0.0
        for k, stage in enumerate(self.schedule):
            steps = stage.expected_steps
            total += steps * stage.cost
            if k < self.position:
                done += steps * stage.cost
            elif k == self.position:
                done += min(self.memory.count, steps) * stage.cost
        return done / total if total else 1.0

    @property
    def present(self) -> Model:
        """The model that a step starts from; every schedule begins with a start."""
        assert self.model is not None
        return self.model

    @property
    def best_model(self) -> Model:
        """Of the bones asked for; a run has one after its first steps."""
        assert self.best is not None
        return self.best

    def begin_with(self, model: Model) -> None:
        """Start from a copy of a model in place of a stage that makes one."""
        self.model = model.copy()
        if model.n_bones == self.bones:
            self.best, self.best_value = model.copy(), self.value(model)

    def drive(self, after_step: Callable[[str], str | None] | None = None) -> str | None:
        """Steps until the schedule ends, or `after_step` gives a reason to stop.

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
            while not self.finished:
                phase = self.phase
                self.advance()
                reason = None if after_step is None else after_step(phase)
                if reason is not None:
                    return reason
        return None

    def advance(self) -> None:
        """One small step."""
        stage = self.schedule[self.position]
        over = stage.step(self)
        self.memory.count += 1
        self._record(stage.phase)
        if over or self.memory.count >= stage.steps:
            self._next()
        if self.best_value <= _EXACT * float(self.whole.x2.sum()):
            self.position, self.converged = len(self.schedule), True

    def value(self, model: Model) -> float:
        """The objective: squared error, and what joints and weights add where asked to."""
        penalty = 0.0 if self.smoothness is None else self.smoothness.penalty(model)
        return Objective(self.asked).value(self.data, model) + penalty

    def start_branch(self) -> None:
        self.branch_rng = copy.deepcopy(self.rng)

    def judge(self, trial: Model, patience: int) -> bool:
        """Go on from the trial if it is better; whether too many in a row were not."""
        if self.value(trial) < self.value(self.present):
            self.model, self.memory.failures = trial, 0
        else:
            self.memory.failures += 1
        return self.memory.failures >= patience

    def compress(self) -> None:
        self.whole = self.data = self.whole.compressed(self.bones)

    def take_sample(self, count: int) -> None:
        """Work on about so many vertices from now on, evenly from still to wild ones.

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
        self.data, self.polish = self.whole, None

    def followed_by(
        self,
        data: Trajectories,
        schedule: Sequence[Stage],
        prescribed: Prescribed,
        smoothness: WeightSmoothness | None,
    ) -> Run:
        """A run on other frames that counts on from this one's steps and seconds."""
        run = Run(
            data,
            schedule,
            bones=self.bones,
            influences=self.influences,
            rng=self.rng,
            fixed=self.asked,
            prescribed=prescribed,
            smoothness=smoothness,
            clock=self.clock,
            rigid_joints=self.rigid_joints,
        )
        run.iteration = self.iteration
        return run

    def progress(self) -> dict[str, Any]:
        """What :meth:`restore` needs beside the models."""
        memory = dataclasses.asdict(self.memory)
        return memory | {
            "position": self.position,
            "iteration": self.iteration,
            "lead": self.leader,
            "settled": self.converged,
            "elapsed": self.clock.elapsed,
            "best_value": self.best_value,
            "rng": self.rng.bit_generator.state,
            "branch_rng": self.branch_rng.bit_generator.state,
        }

    def restore(
        self,
        progress: dict[str, Any],
        model: Model | None,
        best: Model | None,
        aside: Model | None,
        records: list[tuple[int, float, float, str]],
    ) -> None:
        """Go on where a saved run was.

        Raises
        ------
        KeyError, TypeError, ValueError
            If `progress` is damaged.
        """
        self.model, self.best, self.aside, self.records = model, best, aside, records
        self.memory = self._memory_of(progress)
        begun = self.position > 0 or self.memory.count > 0
        if (begun and model is None) or (self.finished and best is None):
            raise ValueError("there is no model")
        if best is not None and best.n_bones != self.bones:
            raise ValueError(f"the best model has {best.n_bones} bones")
        self.iteration = whole(progress, "iteration")
        if not isinstance(progress["settled"], bool):
            raise ValueError(f"settled is {progress['settled']!r}")
        self.converged, self.leader = progress["settled"], numbers(progress, "lead")
        self.best_value = np.inf if best is None else number(progress, "best_value")
        self.clock.before = number(progress, "elapsed")
        self.branch_rng = copy.deepcopy(self.rng)
        self.branch_rng.bit_generator.state = progress["branch_rng"]
        self.rng.bit_generator.state = progress["rng"]

    def go_to(self, position: int) -> None:
        """The place in the schedule, with the data as the stages before it leave them.

        Raises
        ------
        ValueError
            If the schedule is shorter.
        """
        if position > len(self.schedule):
            raise ValueError(f"position is {position}")
        self.position = position
        for stage in self.schedule[:position]:
            stage.prepare(self)

    def _memory_of(self, progress: dict[str, Any]) -> Memory:
        memory = Memory(
            count=whole(progress, "count"),
            failures=whole(progress, "failures"),
            damping=None if progress["damping"] is None else number(progress, "damping"),
            recent=numbers(progress, "recent"),
            track=numbers(progress, "track"),
            turns=[int(t) for t in numbers(progress, "turns", least=-np.inf)],
            misses=[int(t) for t in numbers(progress, "misses")],
        )
        kinds = self.stage.changes if self.stage is not None and memory.track else 0
        if not len(memory.turns) == len(memory.misses) == kinds:
            raise ValueError(f"{len(memory.turns)} turns and {len(memory.misses)} misses")
        return memory

    def _record(self, phase: str) -> None:
        model = self.model
        if self.chosen is not None:
            return
        if model is None or model.n_bones != self.bones or model.n_influences > self.influences:
            return
        if self.rigid_joints and (model.tree is None or not model.tree.rigid):
            return
        value = self.value(model)
        if value < self.best_value:
            self.best, self.best_value = model.copy(), value
            # records hold the error alone, without the penalty that `value` may carry
            error = model.weighted_error(self.data)
            self.records.append((self.iteration, self.clock.elapsed, error, phase))

    def _next(self) -> None:
        track = self.memory.track
        if track and (not self.leader or track[-1] < self.leader[-1]):
            self.leader = track
        self.position += 1
        self.memory = Memory()
        self.polish = self.recycled = None
