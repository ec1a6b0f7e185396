"""Search for the smallest model: the fewest bones that hold a tolerance, then pruning."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from ..common.checks import check_squarable
from ..common.errors import Cancelled
from ..model.frame_error import motion_rms
from ..model.size import size
from ..model.skinning import Skinning
from ..search.descent import Descent
from ..search.problem import Problem
from ..search.progress import Record, Stop
from ..search.solve import SCANNED, with_normals
from ..search.starts import start_from_model
from ..search.trees.tree_steps import attach_unattached
from ..solver.model import Model
from ..solver.trajectories import Trajectories
from .fewest_bones import Bounds, fewest_bones, polish_fewest
from .models_by_bones import PRUNING, ModelsByBones
from .pruning import prune
from .rank import rank_bound, rank_of, reduced
from .report import Measure, Parsimony, Pruning, Smallest
from .solved_frames import SolvedFrames

_ROUNDING = 1e-13  # error that counts as zero, relative to the largest coordinate
_LOOSE = 10.0  # largest tolerance in use, relative to the scale of the frames
_RETRIES = 4  # most searches on representative frames, each with a stricter tolerance


def find_smallest(problem: Problem, *, asked: float, measure: Measure) -> Smallest:
    """Find the smallest model that holds a tolerance; if none does, that of least error.

    Parameters
    ----------
    problem : Problem
        Its `bones` is the largest number of bones allowed.
    asked : float
        The tolerance, in the mesh's units.
    measure : {"rmse", "max"}

    Raises
    ------
    Cancelled
        If the callback stopped the search before there was a model.
    """
    frames, monitor = SolvedFrames(problem, measure), problem.monitor
    tolerance = _usable_tolerance(frames, asked)
    allowed, (least, exact) = frames.squared(tolerance), _least_bones(frames, tolerance)
    frames.data = reduced(frames.data, allowed)

    def report(phase: str, ready: bool = True) -> None:
        held = models.fewest
        if held is not None:
            monitor.offer(lambda: frames.skinning(models.best[held].model))
        monitor.report(
            phase,
            iteration=models.iteration,
            rmse=math.inf if held is None else models.best[held].value,
            fraction=models.fraction,
            ready=ready,
        )

    def on_all_frames() -> None:
        report("all frames")

    def pruned(model: Model, data: Trajectories) -> Skinning:
        report("pruning")
        return frames.skinning_of_all(model, entering=0, report=on_all_frames, data=data)

    models = ModelsByBones(frames, report, tolerance=tolerance)
    models.fraction = 0.0 if frames.scan is None else SCANNED
    bounds = Bounds(min(least, problem.bones), problem.bones, exact)
    skinning, reason, prunings = None, "tolerance held", list[Pruning]()
    try:
        if problem.start is not None:
            bones = problem.start.n_bones
            models.attempt(bones, _begin_with_model, initial=frames.initial)
        # If frames are streamed, the search solves representative ones.  It is then repeated with a
        # stricter tolerance until the model holds the tolerance on all frames.
        for _ in range(_RETRIES):
            fewest_bones(models, bounds, problem.effort)
            held = models.fewest
            if held is None:
                break
            polish_fewest(models, problem.effort)
            model = models.best[held].model
            skinning = frames.skinning_of_all(model, report=on_all_frames)
            monitor.raise_if_stopped()
            error = frames.error_of_all(skinning)
            if error <= tolerance or frames.scan is None:
                break
            models.tolerance *= 0.99 * tolerance / error
            bounds = dataclasses.replace(bounds, least=held)
        if skinning is not None and models.held:
            prunings.append(_fewer_bones(frames, models.held[0], models.held[-1]))
            if frames.error_of_all(skinning) <= tolerance:
                models.fraction = PRUNING
                model = models.best[models.fewest or models.held[-1].n_bones].model
                skinning, more = prune(frames, model, tolerance, skinning, pruned)
                prunings += more
    except Stop as stop:
        reason = str(stop)
    if skinning is None:
        if models.smallest is None:
            raise Cancelled("stopped by the callback before there was any model")
        skinning = frames.skinning_of_all(models.smallest, report=on_all_frames)
    return _result(frames, models, skinning, reason, prunings, asked, tolerance, least)


def _usable_tolerance(frames: SolvedFrames, asked: float) -> float:
    """The tolerance `asked`, clipped to the range in which errors can be computed."""
    data = frames.data
    check_squarable(data.alignment.centre, "vertices")
    largest = max(float(np.abs(data.alignment.centre).max()), data.alignment.scale)
    # a tolerance so large that every model holds it is reduced, since its square may overflow
    most = _LOOSE * data.alignment.scale * math.sqrt(data.n_frames * data.n_vertices)
    return max(min(asked, most), _ROUNDING * largest)


def _least_bones(frames: SolvedFrames, tolerance: float) -> tuple[int, int]:
    """Lower bound on the number of bones, and upper bound on that of an exact skinning.

    Both follow from the rank of the motion, unless all parts of the mesh are rigid: then the second
    is their number.  It is 0 if the rank does not suggest that there is an exact skinning.
    """
    problem, parts = frames.problem, frames.data.parts
    pieces = 0 if parts is None or parts.min() < 0 else len(np.unique(parts))
    if problem.weighted or problem.rows is not None or frames.scan is not None:
        return 1, pieces
    least = rank_bound(frames.data, frames.squared(tolerance))
    if pieces:
        return least, pieces
    # an exact skinning has the rank 4B − 1, less one for each joint that two bones share: since
    # the rank is at least 3B, there are at most a third as many bones
    exact = -(-rank_of(frames.data, 0.0) // 3)
    return least, 0 if exact > 2 * least + 1 else exact


def _fewer_bones(frames: SolvedFrames, first: Model, last: Model) -> Pruning:
    counts, stored = (first.n_bones, last.n_bones), (frames.bytes(first), frames.bytes(last))
    return Pruning("bones", *counts, *stored, frames.error(first), frames.error(last))


def _result(
    frames: SolvedFrames,
    models: ModelsByBones,
    skinning: Skinning,
    reason: str,
    prunings: list[Pruning],
    asked: float,
    tolerance: float,
    least: int,
) -> Smallest:
    problem = frames.problem
    skinning, normals = with_normals(problem, skinning)
    error, rmse = (frames.error_of_all(skinning, m) for m in (frames.measure, "rmse"))
    held = error <= tolerance
    if not held and reason == "tolerance held":
        reason = "tolerance out of reach"
    elapsed = problem.monitor.elapsed
    last = Record(iteration=models.iteration, elapsed=elapsed, rmse=rmse, phase="result")
    parsimony = Parsimony(
        tolerance=asked,
        measure=frames.measure,
        error=error,
        held=held,
        bones=skinning.n_bones,
        influences=skinning.n_influences,
        least_bones=least,
        size=size(skinning),
        prunings=tuple(prunings),
    )
    return Smallest(
        skinning=skinning,
        rmse=rmse,
        stop_reason=reason,
        history=(*models.records, last),
        offsets=problem.offsets,
        normals=normals,
        motion=motion_rms(problem.inputs, executor=problem.executor),
        copies=problem.copies,
        warnings=() if held else (_shortfall(problem, parsimony, reason),),
        parsimony=parsimony,
    )


def _shortfall(problem: Problem, found: Parsimony, reason: str) -> str:
    """Text of the warning that the tolerance is not held."""
    diagonal = max(s.diagonal() for s in problem.sequences)

    def text(value: float) -> str:
        share = f" ({100 * value / diagonal:.3g} % of the diagonal)" if diagonal else ""
        return f"{value:.4g}{share}"

    asked = text(found.tolerance)
    head = f"stopped ({reason}) before tolerance {asked} was held"
    if reason == "tolerance out of reach":
        head = f"tolerance {asked} is out of reach"
        if found.least_bones > problem.bones:
            head += f", the motion's rank asks for at least {found.least_bones} bones"
    kind = {"rmse": "RMSE", "max": "largest error"}[found.measure]
    most = f"{found.bones} bones of at most {problem.influences} influences"
    return f"{head}: {most} reach a {kind} of {text(found.error)}"


def _begin_with_model(d: Descent) -> None:
    start_from_model(d)
    if d.rigid_joints:
        attach_unattached(d)
