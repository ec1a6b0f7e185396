"""Steps of a descent that change which bones there are, or which influences, on trial."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from ..solver.model import Locked, Model
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

__all__ = [
    "STEPS_OF_A_TRIAL",
    "Change",
    "add_and_merge",
    "merge",
    "move_bones",
    "search",
    "tried",
]

STEPS_OF_A_TRIAL = 8  # polish steps before a trial of a search is judged
# Ratio of a trial's objective to the present one below which the trial is polished once more.
_CLOSE = 1.02
# Most failures that count against a kind of change, so that none is given up for good.
_MOST_MISSES = 8

# A function that returns a changed copy of a model.
Change = Callable[[Trajectories, Model, np.random.Generator, Locked], Model]
CHANGES: tuple[Change, ...] = (exchange_bones, alternate_some, exchange_influences)


@step("merge", cost=20)
def merge(d: Descent, *, steps: int = 3, alternations: int = 4) -> Iterator[None]:
    """Remove excess bones, in each step the cheapest third of the excess, and alternate.

    The cheapest bones are those whose removal raises the objective least; `steps` are expected for
    0.6 excess bones per bone asked for.
    """
    while d.model.n_bones > d.bones:
        d.model = merge_bones(d.data, d.model, d.bones, alternations, d.locked)
        d.iteration += alternations
        yield


@step("move bones", cost=6)
def move_bones(
    d: Descent, *, steps: int = 16, patience: int = 4, alternations: int = 4
) -> Iterator[None]:
    """Move one of the cheapest bones to where the error is largest; keep the better model.

    It ends after `patience` moves in a row without a lower objective.
    """
    failures = 0
    for _ in range(steps):
        trial = move_cheapest_bone(d.data, d.model, d.rng, alternations, d.locked)
        d.iteration += alternations
        if trial is None:  # no bone can move
            yield
            return
        failures = 0 if d.accept_if_lower(trial) else failures + 1
        yield
        if failures >= patience:
            return


@step("add and merge", cost=20)
def add_and_merge(
    d: Descent, *, steps: int = 1, patience: int = 0, alternations: int = 3
) -> Iterator[None]:
    """Add several bones where the error is largest, and merge down to the number before.

    It ends after `patience` changes in a row without a lower objective.  With 0, one change is made
    and kept in any case, since its worth shows only after the model is relaxed and searched.
    """
    failures = 0
    for _ in range(steps):
        trial = add_and_merge_bones(d.data, d.model, d.rng, alternations, d.locked)
        d.iteration += alternations
        if patience:
            failures = 0 if d.accept_if_lower(trial) else failures + 1
        else:
            d.model = trial
        yield
        if failures >= patience:
            return


@step("search", cost=60)
def search(d: Descent, *, steps: int, gain: float = 1e-3) -> Iterator[None]:
    """Change the model in one of several ways, polish, and keep the better model.

    A trial is a success if it lowers the objective by the share `gain`.
    """
    return tried(d, CHANGES, polished_value, steps=steps, gain=gain)


def tried(
    d: Descent,
    changes: Sequence[Change],
    polished: Callable[[Descent, Model, float], float],
    *,
    steps: int,
    gain: float,
) -> Iterator[None]:
    """Try changes of the model, `steps` in all, and keep each that lowers the objective.

    Parameters
    ----------
    d : Descent
    changes : sequence of Change
    polished : callable
        Polishes a trial (in place), which has to beat a given objective; returns its objective.
    steps : int
    gain : float
        Relative decrease of the objective that makes a trial a success.
    """
    last_turn, misses, failures = list(range(-len(changes), 0)), [0] * len(changes), 0
    for k in range(steps):
        base = d.value(d.model)
        # Take the change with the longest wait divided by 1 + its recent failures, so that all take
        # turns while they succeed.  Which changes succeed differs between sequences, and between
        # early and late in a run.
        waits = [(k - t) / (1 + m) for t, m in zip(last_turn, misses, strict=True)]
        kind = int(np.argmax(waits))
        trial = changes[kind](d.data, d.model, d.rng, d.locked)
        value = polished(d, trial, base)
        d.iteration += STEPS_OF_A_TRIAL
        if value < base:
            d.model = trial
        success = value < (1.0 - gain) * base
        failures = 0 if success else failures + 1
        last_turn[kind] = k
        misses[kind] = 0 if success else min(misses[kind] + 1, _MOST_MISSES)
        d.converged = failures >= steps
        yield


def polished_value(d: Descent, trial: Model, base: float) -> float:
    """Polish a trial (in place), once more if it is close above `base`; return its objective."""
    polish_steps(d.data, trial, STEPS_OF_A_TRIAL, d.locked)
    value = d.value(trial)
    if base <= value < _CLOSE * base:
        polish_steps(d.data, trial, STEPS_OF_A_TRIAL, d.locked)
        value = d.value(trial)
    return value
