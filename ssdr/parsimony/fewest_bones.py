"""Search for the fewest bones that hold a tolerance.

    climb      new starts with more and more bones, from a proven lower bound, until one holds it
    descend    merge bones to smaller numbers; refine the number just below one that holds it
    refine     new starts with that number of bones, then a long search around the best model

An attempt ends as soon as it holds the tolerance.
"""

from __future__ import annotations

import dataclasses
import math
from functools import partial

from ..search.descent import Descent
from ..search.problem import Effort
from ..search.steps import polish
from .models_by_bones import ModelsByBones, merge_down, move_some, search_long, start_merged

_GROWTH = 1.5  # next number of bones, relative to one that misses the tolerance
# Number of bones, relative to the proven bound, up to which a large error may be that of a bad
# local minimum.
_NEAR_RANK = 1.5
_MOVES = 6  # number of moves of bones, or of changes of the tree, in a short search
_AGAIN = 1.3  # bones of a last new start, relative to the fewest bones to which they are merged


@dataclasses.dataclass(frozen=True)
class Refinement:
    """Work spent on a number of bones before it is given up.

    Attributes
    ----------
    polish : int
        Most polish steps of a merged model.
    starts : tuple of float
        Number of bones of each new start, relative to the number to which they are merged.
    moves, trials : int
        Number of moves of bones, and of trials, in the long search around the best model.
    give_up : float
        Error, relative to the tolerance, above which the number of bones is given up early.
    finish : int
        Most polish steps of the model with the fewest bones before it is pruned.
    """

    polish: int
    starts: tuple[float, ...]
    moves: int
    trials: int
    give_up: float
    finish: int


_MANY_STARTS = (1.6, 2.2, 3.0, 1.3, 1.9, 2.6)
REFINEMENT: dict[Effort, Refinement] = {
    "fast": Refinement(6, (), 6, 0, 1.1, 0),
    "balanced": Refinement(12, _MANY_STARTS[:3], 24, 8, 1.3, 16),
    "best": Refinement(20, _MANY_STARTS, 60, 30, 1.6, 60),
}


@dataclasses.dataclass(frozen=True)
class Bounds:
    """Bounds of the search for the fewest bones that hold a tolerance.

    Attributes
    ----------
    least : int
        Proven lower bound.
    most : int
        Largest number allowed.
    exact : int
        Most bones that an exact skinning of the motion may have if its bones share joints; 0 if the
        motion's rank does not suggest that there is one.
    """

    least: int
    most: int
    exact: int


def fewest_bones(models: ModelsByBones, bounds: Bounds, effort: Effort) -> None:
    """Search until a number of bones holds the tolerance and the next smaller is given up.

    Parameters
    ----------
    models : ModelsByBones
        Filled with the models found.
    bounds : Bounds
    effort : {"fast", "balanced", "best"}
    """
    if models.fewest is None:
        climb(models, bounds, effort)
    if models.fewest is not None:
        descend(models, bounds, effort)


def climb(models: ModelsByBones, bounds: Bounds, effort: Effort) -> None:
    """Try new starts with more and more bones until one holds the tolerance."""
    least, most, exact = bounds.least, bounds.most, bounds.exact
    bones = least
    while True:
        models.attempt(bones, start_and_polish)
        if (bones == most or least < bones == exact) and not models.fits(bones):
            refine(models, bones, bounds, effort)
        if models.fewest is not None or bones >= most:
            return
        larger = max(bones + 1, math.ceil(_GROWTH * bones))
        # the number of bones of an exact skinning is not skipped
        bones = min(most, exact if bones < exact < larger else larger)


def descend(models: ModelsByBones, bounds: Bounds, effort: Effort) -> None:
    """Merge bones, bisecting between a number that misses the tolerance and one that holds it.

    A number just below one that holds the tolerance is refined before it is given up.
    """
    steps, least = REFINEMENT[effort].polish, bounds.least
    low = max((b for b in models.best if b < models.held_bones), default=least - 1)
    while (held := models.held_bones) > least:
        bones = max((low + held) // 2, least) if held - low > 1 else held - 1
        wide = models.best[held].model.with_restarted_support()
        models.attempt(bones, partial(merge_and_polish, steps=steps), start=wide)
        if not models.fits(bones):
            if held - bones > 1:
                low = bones
                continue
            refine(models, bones, bounds, effort)
            if not models.fits(bones):
                return
        if models.held_bones <= low + 1:  # `low` missed the tolerance, but was not refined
            low = max(least - 1, models.held_bones - 2)


def refine(models: ModelsByBones, bones: int, bounds: Bounds, effort: Effort) -> None:
    """Try harder to hold the tolerance with a number of bones.

    Improve the model, then try new starts, then search for long, as far as the effort allows.  End
    early if the tolerance is held or out of reach.
    """
    spend = REFINEMENT[effort]
    # with exact skinning the error falls abruptly at the right number of bones, so that a large
    # error just below it says nothing
    abrupt = bounds.exact > 0 or (bounds.least > 1 and bones < _NEAR_RANK * bounds.least + 1)

    def given_up() -> bool:
        hopeless = models.best[bones].value > spend.give_up * models.tolerance
        return models.fits(bones) or (hopeless and not abrupt)

    lowest = models.best[bones].model.with_restarted_support()
    models.attempt(bones, partial(_improve, steps=spend.polish), start=lowest)
    # a start from as many bones as rigid parts have motions is exact
    starts = (1.0, *spend.starts) if bounds.exact else spend.starts
    for factor in starts:
        if given_up():
            return
        models.attempt(bones, partial(_start_anew, factor=factor, steps=8))
    if given_up() or not spend.trials:
        return
    lowest = models.best[bones].model.with_restarted_support()
    search = partial(search_long, moves=spend.moves, trials=spend.trials)
    models.attempt(bones, search, start=lowest)


def polish_fewest(models: ModelsByBones, effort: Effort) -> None:
    """Lower the error at the fewest bones, so that pruning may add more error."""
    steps, held = REFINEMENT[effort].finish, models.held_bones
    if steps:
        last = partial(polish, steps=steps, gain=0.005)
        models.attempt(held, last, start=models.best[held].model, until=0.0)
        again = partial(_start_anew, factor=_AGAIN, steps=steps)
        models.attempt(held, again, until=0.0)


def start_and_polish(d: Descent) -> None:
    """Make a new start; improve it by a few moves of bones and a polish."""
    start_merged(d, 1.6)
    move_some(d, _MOVES)
    polish(d, steps=24, gain=0.01)


def merge_and_polish(d: Descent, steps: int) -> None:
    """Remove the bones whose removal costs least, and polish the others."""
    merge_down(d)
    polish(d, steps=steps, gain=0.005)


def _improve(d: Descent, steps: int) -> None:
    move_some(d, _MOVES)
    polish(d, steps=steps, gain=0.005)


def _start_anew(d: Descent, factor: float, steps: int) -> None:
    start_merged(d, factor)
    polish(d, steps=steps, gain=0.005)
