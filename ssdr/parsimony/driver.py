"""Driver of ``smallest``: the fewest bones that hold the tolerance, then the fewest bytes."""

from __future__ import annotations

import math

import numpy as np

from ..checks import check_squarable
from ..errors import Cancelled
from ..frames.motion import motion_rms
from ..problem.answer import with_normals
from ..problem.problem import Problem
from ..problem.progress import Clock, ProgressReport, Record
from ..search.descent import Descent
from ..search.starts import start_from_model
from ..search.streamed import PASSES, SCANNED
from ..search.tree_steps import attach_unattached
from ..skinning import Skinning
from ..solver.model import Model
from ..solver.trajectories import Trajectories
from .fewest_bones import FewestBones
from .ladder import Ladder, Stopped
from .pruning import Pruner
from .rank import rank_bound, rank_of, reduced
from .report import Measure, Parsimony, Pruning, Smallest
from .solved_frames import SolvedFrames, Written

__all__ = ["Driver"]

_ROUNDING = 1e-13  # error that counts as zero, relative to the largest coordinate
_LOOSE = 10.0  # largest tolerance in use, relative to the scale of the frames
_RETRIES = 4  # most searches on representative frames, each with a stricter tolerance


class Driver:
    """Search for the smallest model that holds a tolerance.

    Parameters
    ----------
    problem : Problem
        Its `bones` is the largest number of bones allowed.
    tolerance : float
        In the mesh's units.
    measure : {"rmse", "max"}
    written : Written, optional
        For a file that is to hold the tolerance, too.
    angle : float, optional
        Tolerance of the mean angle of drawn normals, in degrees.
    """

    def __init__(
        self,
        problem: Problem,
        tolerance: float,
        measure: Measure,
        written: Written | None = None,
        angle: float | None = None,
    ) -> None:
        self.problem, self.asked, self.clock = problem, tolerance, Clock()
        self.progress = ProgressReport(problem.callback, self.clock, problem.time_limit)
        self.frames = frames = SolvedFrames(problem, measure, self.clock, written)
        data = frames.data
        check_squarable(data.centre, "vertices")
        largest = max(float(np.abs(data.centre).max()), data.scale)
        # a tolerance so large that every model holds it is reduced, since its square may overflow
        most = _LOOSE * data.scale * math.sqrt(data.n_frames * data.n_vertices)
        self.tolerance = max(min(tolerance, most), _ROUNDING * largest)
        self.least, exact = self._least_bones()
        allowed, self.angle = frames.squared(self.tolerance), angle
        frames.data = reduced(data, allowed)
        if angle is not None:
            frames.degree, frames.slack = self.tolerance / angle, allowed
        self.ladder = Ladder(frames, self.report, self.clock, tolerance=self.tolerance)
        self.ladder.fraction = 0.0 if frames.scan is None else SCANNED
        most_bones, effort = problem.bones, problem.effort
        self.search = FewestBones(
            self.ladder, min(self.least, most_bones), most_bones, exact, effort
        )
        self.skinning: Skinning | None = None  # the last skinning made for all frames
        self.prunings: list[Pruning] = []
        self.stopped: str | None = None

    def _least_bones(self) -> tuple[int, int]:
        """Lower bound on the number of bones, and most bones that an exact skinning may have.

        Both follow from the rank of the motion.  The second is 0 if the rank does not suggest that
        there is an exact skinning.
        """
        problem, frames = self.problem, self.frames
        if problem.weighted or problem.rows is not None or frames.scan is not None:
            return 1, 0
        least = rank_bound(frames.data, frames.squared(self.tolerance))
        # an exact skinning has the rank 4B − 1, less one for each joint that two bones share: since
        # the rank is at least 3B, there are at most a third as many bones
        exact = -(-rank_of(frames.data, 0.0) // 3)
        return least, 0 if exact > 2 * least + 1 else exact

    def solve(self) -> Smallest:
        """Find the smallest model that holds the tolerance; if none does, that of least error.

        Raises
        ------
        Cancelled
            If the callback stopped the search before there was a model.
        """
        reason = "tolerance held"
        try:
            self._start_from_model()
            self._find_bones()
            self._prune()
        except Stopped as stop:
            reason = stop.reason
        if self.skinning is None:
            model = self.ladder.smallest
            if model is None:
                raise Cancelled("stopped by the callback before there was any model")
            self.skinning = self.frames.skinning_of_all(model, passes=1, on_progress=self._stops)
        return self._result(self.skinning, reason)

    def report(self, phase: str, iteration: int, fraction: float, ready: bool = True) -> None:
        """Report a step, and offer the smallest model so far to the checkpoint.

        Raises
        ------
        Stopped
            If the callback asks to stop, or if time is up and there is a model (`ready`).
        """
        ladder, held = self.ladder, self.ladder.fewest
        if held is not None:
            self.problem.checkpoint.offer(lambda: self.frames.skinning(ladder.models[held]))
        if self.stopped is None:
            rmse = math.inf if held is None else ladder.errors[held]
            if self.progress(phase, iteration=iteration, rmse=rmse, fraction=fraction):
                self.stopped = "cancelled"
            elif ready and self.progress.out_of_time:
                self.stopped = "time limit"
        if self.stopped is not None:
            raise Stopped(self.stopped)

    def _stops(self) -> bool:
        """Report within a pass over all frames; return True if the search ends after this pass."""
        try:
            self.report("all frames", self.ladder.iteration, self.ladder.fraction)
        except Stopped:
            return True
        return False

    def _start_from_model(self) -> None:
        model, given = self.problem.start, self.frames.given
        if model is not None:
            self.ladder.attempt(model.n_bones, _begin_with_given, "given", given=given)

    def _find_bones(self) -> None:
        """Find the fewest bones.

        If frames are streamed, the search solves representative ones, and if weights are stored in
        integers or the model in a file, it knows no rounding.  It is then repeated with a stricter
        tolerance until the rounded model holds the tolerance on all frames.
        """
        ladder, frames, search = self.ladder, self.frames, self.search
        exact = frames.scan is None and self.problem.storage == "float32" and not frames.written
        for _ in range(_RETRIES):
            search.run()
            held = ladder.fewest
            if held is None:
                return
            search.finish()
            model, passes = ladder.models[held], PASSES[self.problem.effort]
            self.skinning = frames.skinning_of_all(model, passes=passes, on_progress=self._stops)
            if self.stopped is not None:
                raise Stopped(self.stopped)
            error = self._kept_error(self.skinning)
            if error <= self.tolerance or exact or error == math.inf:
                return
            ladder.tolerance *= 0.99 * self.tolerance / error
            search.least = held

    def _kept_error(self, skinning: Skinning) -> float:
        """Error of a skinning or, if it holds the tolerance, the larger of its and its file's."""
        error = self.frames.error_of_all(skinning)
        return self.frames.kept(skinning, error, self.tolerance)[1]

    def _prune(self) -> None:
        """Drop influences and keyframes as far as the tolerance allows."""
        frames, ladder = self.frames, self.ladder
        if self.skinning is None or not ladder.held:
            return
        ends = [ladder.held[0], ladder.held[-1]]
        counts = [model.n_bones for model in ends]
        stored, errors = map(frames.bytes, ends), map(frames.error, ends)
        self.prunings.append(Pruning("bones", *counts, *stored, *errors))
        if self._kept_error(self.skinning) > self.tolerance:
            return

        def skinning(model: Model, data: Trajectories) -> Skinning:
            self.report("pruning", ladder.iteration, 0.95)
            few = {"passes": 1, "entering": 0}
            return frames.skinning_of_all(model, **few, on_progress=self._stops, data=data)

        model = ladder.models[ladder.fewest or ladder.held[-1].n_bones]
        pruner = Pruner(frames, model, self.tolerance, skinning)
        self.skinning, prunings = pruner.run(self.skinning)
        self.prunings += prunings

    def _result(self, skinning: Skinning, reason: str) -> Smallest:
        frames, ladder, problem = self.frames, self.ladder, self.problem
        skinning, normals = with_normals(problem, skinning)
        error, rmse = (frames.error_of_all(skinning, m) for m in (frames.measure, "rmse"))
        angle, file = 0.0 if normals is None else normals.mean, frames.file(skinning)
        worst = (error, angle)
        if file is not None:
            worst = max(error, file.error), max(angle, file.normals or 0.0)
        held = frames.larger(*worst) <= self.tolerance
        if not held and reason == "tolerance held":
            reason = "tolerance out of reach"
        last = Record(
            iteration=ladder.iteration, elapsed=self.clock.elapsed, rmse=rmse, phase="result"
        )
        return Smallest(
            skinning=skinning,
            rmse=rmse,
            stop_reason=reason,
            history=(*ladder.records, last),
            offsets=problem.offsets,
            normals=normals,
            motion=motion_rms(problem.inputs, executor=problem.executor),
            copies=problem.copies,
            warnings=() if held else (self._shortfall(skinning, *worst, reason),),
            parsimony=Parsimony(
                tolerance=self.asked,
                measure=frames.measure,
                normals_tolerance=self.angle,
                error=error,
                held=held,
                bones=skinning.n_bones,
                influences=skinning.n_influences,
                least_bones=self.least,
                size=frames.size(skinning),
                prunings=tuple(self.prunings),
                attempts=tuple(ladder.attempts),
                file=file,
            ),
        )

    def _shortfall(self, skinning: Skinning, error: float, angle: float, reason: str) -> str:
        """Text of the warning that the tolerance is not held."""
        if error == math.inf:
            return f"stopped ({reason}): the weights of the file are too coarse for its tolerance"
        diagonal = max(s.diagonal() for s in self.problem.sequences)

        def text(value: float, degrees: float | None) -> str:
            share = f" ({100 * value / diagonal:.3g} % of the diagonal)" if diagonal else ""
            normals = f" and {degrees:.3g}° of normals" if self.angle else ""
            return f"{value:.4g}{share}{normals}"

        asked = text(self.asked, self.angle)
        head = f"stopped ({reason}) before tolerance {asked} was held"
        if reason == "tolerance out of reach":
            head = f"tolerance {asked} is out of reach"
            if self.least > self.problem.bones:
                head += f", the motion's rank asks for at least {self.least} bones"
        kind = {"rmse": "RMSE", "max": "largest error"}[self.frames.measure]
        most = self.problem.influences
        where = "reach a" if self.frames.written is None else "reach in the file a"
        reached = f"{skinning.n_bones} bones of at most {most} influences {where} {kind} of"
        return f"{head}: {reached} {text(error, angle)}"


def _begin_with_given(d: Descent) -> None:
    start_from_model(d)
    if d.rigid_joints:
        attach_unattached(d)
