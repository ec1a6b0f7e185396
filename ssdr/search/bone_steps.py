"""Steps of a descent that add, remove and move bones, or exchange influences."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from ..solver.model import Constraints, Model
from ..solver.trajectories import Trajectories
from .descent import Descent, step
from .moves import (
    add_and_merge_bones,
    alternate_some,
    exchange_bones,
    exchange_influences,
    merge_bones,
    move_cheapest_bone,
    polish_steps,
)

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
        d.iteration += alternations
        yield


@step("move bones", cost=6)
def move_bones(
    d: Descent, *, steps: int = 16, patience: int = 4, alternations: int = 4
) -> Iterator[None]:
    """Move bones whose removal costs least, one at a time, to where the error is largest.

    Each improvement is kept.  It ends after `steps` moves, or `patience` moves in a row that do not
    lower the objective.
    """
    change = partial(move_cheapest_bone, alternations=alternations)
    return tried(d, [change], steps=steps, iterations=alternations, patience=patience)


@step("add and merge", cost=20)
def add_and_merge(d: Descent, *, alternations: int = 3) -> Iterator[None]:
    """Add several bones where the error is largest, and merge down to the previous number.

    The result is kept even if its objective is higher, since it is judged only after a relaxation
    and a search.
    """
    d.model = add_and_merge_bones(d.data, d.model, d.rng, d.constraints, alternations=alternations)
    d.iteration += alternations
    yield


@step("add and merge", cost=20)
def try_places(d: Descent, *, steps: int, patience: int, alternations: int = 3) -> Iterator[None]:
    """Add several bones and merge down to the previous number; keep the better model.

    It ends after `steps` trials, or `patience` trials in a row that do not lower the objective.
    """
    change = partial(add_and_merge_bones, alternations=alternations)
    return tried(d, [change], steps=steps, iterations=alternations, patience=patience)


@step("search", cost=60)
def search(d: Descent, *, steps: int, gain: float = 1e-3) -> Iterator[None]:
    """Try `steps` changes of the model, polish each, and keep each that lowers the objective.

    A trial counts as a success if it lowers the objective by more than the fraction `gain`.
    """
    return tried(d, CHANGES, polished_value, steps=steps, gain=gain)


def tried(
    d: Descent,
    changes: Sequence[Change],
    polished: Callable[[Descent, Model, float], float] | None = None,
    *,
    steps: int,
    gain: float = 0.0,
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
    gain : float
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
        d.iteration += iterations
        if trial is None:
            yield
            return
        value = d.value(trial) if polished is None else polished(d, trial, base)
        if value < base:
            d.model = trial
        success = value < (1.0 - gain) * base
        failures = 0 if success else failures + 1
        last_turn[kind] = k
        misses[kind] = 0 if success else min(misses[kind] + 1, _MOST_MISSES)
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
