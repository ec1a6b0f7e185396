"""Steps that improve all bones together, or choose the vertices or the model of the next steps."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ..solver.alternation import free_gauge, repeat_alternation
from ..solver.gauss_newton import GaussNewton
from ..solver.initialization import with_rest_normals
from ..solver.model import Constraints, Lowest, Model
from ..solver.objective import strength_of
from ..solver.trajectories import Trajectories
from ..solver.vertex_newton import optimise_some
from .descent import LEAST, MOST, Descent, Schedule, step
from .moves import (
    AFTER_A_MOVE,
    AFTER_AN_ADDITION,
    add_and_merge_bones,
    alternate_some,
    exchange_bones,
    exchange_influences,
    merge_bones,
    move_cheapest_bone,
    polish_steps,
    polish_then_drop_influence,
)

# Relative decrease of the objective below which an alternation counts as a failure.
_PLATEAU = 1e-5
# Failures in a row that end the alternations: with fewer, they would end at a pause.
_PLATEAU_ALTERNATIONS = 3
# Rounds of unfolding in which only edges of the flipped triangles become stiffer, and further ones
# until those of all triangles around them do; the factor of a round.
_ALONE, _TO_ALL, _STIFFER = 6, 6, 4.0
_UNFOLD_ROUNDS = 4  # solves of weights and rest pose in a round of unfolding
_MOST_LOSS = 1.02  # largest ratio of the error after unfolding to the one before


# --- all bones -----------------------------------------------------------------------------------


@step("compress", cost=4)
def compress(d: Descent) -> Iterator[None]:
    """Compress the trajectories to as few columns as the bones need: later steps take less time."""
    d.data = d.data.compressed(d.bones)
    yield


@step("alternate")
def alternate(d: Descent, *, steps: int, gain: float = _PLATEAU) -> Iterator[None]:
    """Alternate as Le and Deng: solve the bones, then the weights and the rest pose.

    It ends after `steps` alternations, or three in a row that each lower the objective by less than
    the fraction `gain`.
    """
    failures = 0
    for _ in range(steps):
        before = d.value(d.model)
        repeat_alternation(d.data, d.model, 1, d.constraints, d.smoothness)
        free_gauge(d.data, d.model, d.constraints)
        d.work.iteration += 1
        still = before - d.value(d.model) < max(gain, _PLATEAU) * before
        failures = failures + 1 if still else 0
        d.converged = failures >= _PLATEAU_ALTERNATIONS
        yield
        if d.converged:
            return


@step("alternate")
def look_ahead(d: Descent, *, steps: int) -> Iterator[None]:
    """Alternate on a copy of the present model, for a run that is stopped before a better one.

    What follows starts from the present model all the same, as that leads to less error.
    """
    begun, d.model = d.model, d.model.copy()
    for _ in range(steps):
        repeat_alternation(d.data, d.model, 1, d.constraints)
        d.work.iteration += 1
        yield
    d.model = begun


@step("polish", cost=6)
def polish(d: Descent, *, steps: int, gain: float = 0.0) -> Iterator[None]:
    """Improve all bones together by Gauss–Newton steps with variable projection.

    It ends after `steps` steps, or when the last ones lower the error by less than the fraction
    `gain`.
    """
    newton = GaussNewton(d.data, d.model, constraints=d.constraints)
    for _ in newton.steps(steps, gain=gain):
        d.work.iteration += 1
        d.converged = newton.converged
        yield


@step("relax", cost=40)
def relax(d: Descent, *, steps: int = 4, polish_steps: int = 8) -> Iterator[None]:
    """Widen to K + `steps` influences per vertex; polish, then drop the smallest, down to K.

    A vertex can so exchange its influences for others, which steps at K influences cannot do.
    There are `polish_steps` polish steps at each number of influences, which is at most 2 K, since
    a polish holds (K + 2)² floats per vertex.
    """
    k = d.influences
    model = d.model.with_influences(min(2 * k, k + steps, d.model.n_bones))
    for _ in range(max(1, model.n_influences - k)):
        if model.n_influences > k:
            model = polish_then_drop_influence(d.data, model, d.constraints, steps=polish_steps)
            d.work.iteration += polish_steps
        d.model = model
        yield
        model = d.model


@step("normals", cost=4)
def solve_normals(d: Descent) -> Iterator[None]:
    """Solve rest normals, too, from now on, if these are requested and the bones are rigid.

    Normals come late, since they would lead a search for bones to models with more error.
    """
    if d.normals is None or not len(d.data.faces) or d.constraints.bone_model != "rigid":
        return
    slack = d.data.n_vertices * strength_of(d.data, d.normals)
    d.data = dataclasses.replace(d.data.with_normals(d.bones), slack=slack)
    d.model = with_rest_normals(d.data, d.model)
    if d.best.exists:
        d.set_best(with_rest_normals(d.data, d.best.model))
    yield


def relax_bones(d: Descent) -> None:
    """Relax with five instead of eight polish steps at each number of influences; then polish."""
    relax(d, polish_steps=5)
    polish(d, steps=200, gain=0.004)


def last_polish(d: Descent, *, steps: int, gain: float = 0.0) -> None:
    """Polish with normals in the objective, if :func:`solve_normals` adds them."""
    solve_normals(d)
    polish(d, steps=steps, gain=gain)


@step("unfold")
def unfold(d: Descent, *, steps: int = 24, entering: int = 3) -> Iterator[None]:
    """Unfold the flipped triangles of the rest pose, by making edges stiffer, fourfold a round.

    The edges are at first those of the flipped triangles alone, as stiffer edges cost error.  What
    is still flipped after six rounds lies as in the reference, and the triangles around it have
    turned: then those of them join that have turned by more than an angle, which shrinks from 90°
    to 0 within six more rounds.

    Of the models found whose error is at most 2 % above the first one's, or above what is not seen,
    that with the fewest flipped triangles becomes the best model, even if its objective is higher
    than before: a rest pose with folds is not a surface.  A model without folds that lost more is
    polished, at most twice, since bones and all other vertices may give the loss back; what folds
    again is unfolded.
    At most `entering` further bones become influences of a vertex in each of its solves.
    """
    if d.data.surface is None:
        return
    d.model, constraints = d.best.model.with_restarted_support(), d.constraints
    if d.smoothness is not None:  # these solves of weights would ignore the penalty
        constraints = constraints.with_weights(d.data.n_vertices)
    data, surface, model, faces = d.data, d.data.surface, d.model.copy(), d.data.faces
    most = _MOST_LOSS**2 * max(model.weighted_error(data), data.slack)
    turned = surface.turned(model.rest, faces)
    fewest, polishes = turned.sum(), 2
    for k in range(steps):
        if not fewest or not (turned.any() or polishes):
            return
        if turned.any():
            around = turned if k < _ALONE else np.isin(faces, faces[turned]).any(axis=1)
            tilted = surface.tilted(model.rest, faces, (k - _ALONE) / _TO_ALL)
            stiff = faces[turned | (around & tilted)]
            surface = surface.stiffened(stiff, _STIFFER)
            # far from the stiffer edges nothing has changed
            options: dict[str, int] = {"times": _UNFOLD_ROUNDS, "entering": entering}
            near = surface.around(stiff)
            optimise_some(data, model, near, surface, constraints=constraints, **options)
        else:
            held = dataclasses.replace(data, surface=surface)
            polish_steps(held, model, STEPS_OF_A_TRIAL, constraints, entering=entering > 0)
            polishes -= 1
        turned = surface.turned(model.rest, faces)
        if turned.sum() < fewest and model.weighted_error(data) <= most:
            fewest, d.model = turned.sum(), model.copy()
            d.best = Lowest()  # so that this model becomes the best, whatever its objective
            d.data = dataclasses.replace(data, surface=surface)  # what follows keeps to the edges
        yield


# --- which vertices, which model -----------------------------------------------------------------


def on_sample(
    d: Descent,
    *schedules: Schedule,
    least: int = LEAST,
    most: int = MOST,
    free: bool = True,
) -> bool:
    """Follow schedules on a third of the vertices, then continue from the best model on all.

    The sample, evenly spaced in the order of :func:`by_motion`, has at least `least` and at most
    `most` vertices for each of the `d.bones` bones.  If that would be half of the vertices or more,
    the schedules run on all.  Returns whether they ran on a sample.  If `free`, no surface holds
    the rest pose of the sample: that is enough to find where bones belong.

    Between two schedules the sample's best model is fitted to all vertices, as what a run returns
    that is stopped on the sample; the next schedule goes on from the sample's own.
    """
    count = min(most * d.bones, max(least * d.bones, d.data.n_vertices // 3))
    if 2 * count >= d.data.n_vertices:
        for schedule in schedules:
            schedule(d)
        return False
    few, (*first, last) = d.sample(count, free=free), schedules
    for schedule in first:
        schedule(few)
        all_vertices(d, few.best, alternations=1)
    last(few)
    d.few = None
    all_vertices(d, few.best)
    return True


def for_positions(d: Descent, schedule: Schedule) -> None:
    """Follow a schedule on a copy without normals; make its best model the present one."""
    bare = d.sample(d.data.n_vertices, free=False)
    schedule(bare)
    d.few = None
    all_vertices(d, bare.best)


@step("all vertices", cost=8)
def all_vertices(d: Descent, best: Lowest, *, alternations: int = 8) -> Iterator[None]:
    """Fit the best model of the sample to all vertices, and make it the present one.

    Each vertex takes the weights of the nearest sampled vertex.  Alternations of all vertices
    follow.
    """
    d.model = d.of_all(best.model, alternations)
    d.work.iteration += alternations
    yield


@step("return to best", cost=0)
def return_to_best(d: Descent) -> Iterator[None]:
    """Make the best model so far the present one.

    Its support restarts, unless it is the present model already.
    """
    if d.value(d.model) != d.best.value:
        d.model = d.best.model.with_restarted_support()
    yield


def lowest(d: Descent, *starts: Schedule) -> None:
    """Follow several schedules in turn; continue from the model of lowest objective."""
    found = Lowest()
    for start in starts:
        start(d)
        if not d.planning:
            found.offer(d.model, d.value(d.model))
    if found.exists:
        d.model = found.model


def beside(d: Descent, start: Schedule) -> None:
    """Follow a schedule from another start; if the error rises, restore the former best model.

    With a slack, more error may be worth its normals.
    """
    before, known = copy.copy(d.best), len(d.records)
    start(d)
    if before.exists and not d.data.slack and d.best_error > before.model.weighted_error(d.data):
        d.best = before
        del d.records[known:]


STEPS_OF_A_TRIAL = 8  # polish steps before a trial of a search is judged
# Ratio of a trial's objective to the present one below which the trial is polished once more.
_CLOSE = 1.02
# Most failures that count against a kind of change, so that none is given up for good.
_MOST_MISSES = 8

# A function that returns a changed copy of a model, or None if there is nothing to change.
Change = Callable[[Trajectories, Model, np.random.Generator, Constraints], Model | None]
CHANGES: tuple[Change, ...] = (exchange_bones, alternate_some, exchange_influences)


@step("merge", cost=20)
def merge(d: Descent, *, steps: int = 3, alternations: int = 4) -> Iterator[None]:
    """Remove the bones in excess of `d.bones`, a third of them in each step, and alternate.

    The cheapest bones go first: those whose removal raises the squared error least.  `steps` only
    estimates how many steps this takes, for 1.6 times `d.bones` bones.
    """
    while d.model.n_bones > d.bones:
        d.model = merge_bones(d.data, d.model, d.bones, alternations, d.constraints)
        d.work.iteration += alternations
        yield


@step("move bones", cost=6)
def move_bones(d: Descent, *, steps: int = 16, patience: int = 4) -> Iterator[None]:
    """Move bones whose removal costs least, one at a time, to where the error is largest.

    Each improvement is kept.  It ends after `steps` moves, or `patience` moves in a row that do not
    lower the objective.
    """
    changes = [move_cheapest_bone]
    return tried(d, changes, steps=steps, iterations=AFTER_A_MOVE, patience=patience)


@step("add and merge", cost=20)
def add_and_merge(d: Descent) -> Iterator[None]:
    """Add several bones where the error is largest, and merge down to the previous number.

    The result is kept even if its objective is higher, since it is judged only after a relaxation
    and a search.
    """
    d.model = add_and_merge_bones(d.data, d.model, d.rng, d.constraints)
    d.work.iteration += AFTER_AN_ADDITION
    yield


@step("search", cost=60)
def search(d: Descent, *, steps: int, success: float = 1e-3) -> Iterator[None]:
    """Try `steps` changes of the model, polish each, and keep each that lowers the objective.

    A trial counts as a success if it lowers the objective by more than the fraction `success`.
    """
    return tried(d, CHANGES, polished_value, steps=steps, success=success)


def tried(
    d: Descent,
    changes: Sequence[Change],
    polished: Callable[[Descent, Model, float], float] | None = None,
    *,
    steps: int,
    success: float = 0.0,
    iterations: int = STEPS_OF_A_TRIAL,
    patience: int | None = None,
) -> Iterator[None]:
    """Try changes of the model, `steps` in all, and keep each that lowers the objective.

    Parameters
    ----------
    d : Descent
    changes : sequence of Change
    polished : callable, optional
        Polishes a trial (in place) and returns its objective; the last argument is the objective
        that the trial has to beat.
    steps : int
    success : float
        Relative decrease of the objective that makes a trial a success.
    iterations : int
        Number of alternations or polish steps of a trial.
    patience : int, optional
        Number of failures in a row that ends the search; by default all `steps` are tried.
    """
    last_turn, misses, failures = list(range(-len(changes), 0)), [0] * len(changes), 0
    for k in range(steps):
        base = d.value(d.model)
        # Take the change with the longest wait divided by 1 + its recent failures, so that all take
        # turns while they succeed.  Which changes succeed differs between sequences, and between
        # early and late in a run.
        waits = [(k - t) / (1 + m) for t, m in zip(last_turn, misses, strict=True)]
        kind = int(np.argmax(waits))
        trial = changes[kind](d.data, d.model, d.rng, d.constraints)
        d.work.iteration += iterations
        if trial is None:
            yield
            return
        value = d.value(trial) if polished is None else polished(d, trial, base)
        if value < base:
            d.model = trial
        lower = value < (1.0 - success) * base
        failures = 0 if lower else failures + 1
        last_turn[kind] = k
        misses[kind] = 0 if lower else min(misses[kind] + 1, _MOST_MISSES)
        if patience is None:
            d.converged = failures >= steps
        yield
        if failures == patience:
            return


def polished_value(d: Descent, trial: Model, base: float) -> float:
    """Polish a trial (in place) and return its objective.

    It is polished a second time if its objective is at most 2 % above `base`.
    """
    polish_steps(d.data, trial, STEPS_OF_A_TRIAL, d.constraints)
    value = d.value(trial)
    if base <= value < _CLOSE * base:
        polish_steps(d.data, trial, STEPS_OF_A_TRIAL, d.constraints)
        value = d.value(trial)
    return value
