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
from ..search.efforts import Effort
from ..search.steps import polish
from .ladder import Ladder, merge_down, move_some, search_long, start_merged

__all__ = ["FewestBones"]

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


class FewestBones:
    """Search for the fewest bones that hold a tolerance.

    Parameters
    ----------
    ladder : Ladder
        Filled with the models found.
    least : int
        Proven lower bound on the number of bones.
    most : int
        Largest number of bones allowed.
    exact : int
        Most bones that an exact skinning of the motion may have if its bones share joints; 0 if the
        rank of the motion does not suggest that there is one.
    effort : {"fast", "balanced", "best"}
    """

    def __init__(self, ladder: Ladder, least: int, most: int, exact: int, effort: Effort) -> None:
        self.ladder, self.spend = ladder, REFINEMENT[effort]
        self.least, self.most, self.exact = least, most, exact

    def run(self) -> None:
        """Search until a number of bones holds the tolerance and the next smaller is given up."""
        if self.ladder.fewest is None:
            self.climb()
        if self.ladder.fewest is not None:
            self.descend()

    def climb(self) -> None:
        """Try new starts with more and more bones until one holds the tolerance."""
        ladder, least, most, exact = self.ladder, self.least, self.most, self.exact
        bones = least
        while True:
            ladder.attempt(bones, _climb, "start")
            if (bones == most or least < bones == exact) and not ladder.fits(bones):
                self.refine(bones)
            if ladder.fewest is not None or bones >= most:
                return
            larger = max(bones + 1, math.ceil(_GROWTH * bones))
            # the number of bones of an exact skinning is not skipped
            bones = min(most, exact if bones < exact < larger else larger)

    def descend(self) -> None:
        """Merge bones, bisecting between a number that misses the tolerance and one that holds it.

        A number just below one that holds the tolerance is refined before it is given up.
        """
        ladder, least = self.ladder, self.least
        low = max((b for b in ladder.errors if b < self._held), default=least - 1)
        while (held := self._held) > least:
            bones = max((low + held) // 2, least) if held - low > 1 else held - 1
            wide = ladder.models[held].with_restarted_support()
            ladder.attempt(bones, self._merge, "merged", start=wide)
            if not ladder.fits(bones):
                if held - bones > 1:
                    low = bones
                    continue
                self.refine(bones)
                if not ladder.fits(bones):
                    return
            if self._held <= low + 1:  # `low` missed the tolerance, but was not refined
                low = max(least - 1, self._held - 2)

    @property
    def _held(self) -> int:
        held = self.ladder.fewest
        assert held is not None
        return held

    def refine(self, bones: int) -> None:
        """Try harder to hold the tolerance with a number of bones.

        Improve the model, then try new starts, then search for long, as far as the effort allows.
        End early if the tolerance is held or out of reach.
        """
        ladder, spend = self.ladder, self.spend
        lowest = ladder.models[bones].with_restarted_support()
        ladder.attempt(bones, self._improve, "improved", start=lowest)
        for factor in spend.starts:
            if ladder.fits(bones) or self._hopeless(bones):
                return
            ladder.attempt(bones, partial(_start_anew, factor=factor, steps=8), "new start")
        if ladder.fits(bones) or self._hopeless(bones) or not spend.trials:
            return
        lowest = ladder.models[bones].with_restarted_support()
        search = partial(search_long, moves=spend.moves, trials=spend.trials)
        ladder.attempt(bones, search, "searched", start=lowest)

    def finish(self) -> None:
        """Lower the error at the fewest bones, so that pruning may add more error."""
        ladder, steps, held = self.ladder, self.spend.finish, self._held
        if steps:
            last = partial(polish, steps=steps, gain=0.005)
            ladder.attempt(held, last, "polished", start=ladder.models[held], until=0.0)
            again = partial(_start_anew, factor=_AGAIN, steps=steps)
            ladder.attempt(held, again, "new start", until=0.0)

    def _merge(self, d: Descent) -> None:
        merge_down(d)
        polish(d, steps=self.spend.polish, gain=0.005)

    def _improve(self, d: Descent) -> None:
        move_some(d, _MOVES)
        polish(d, steps=self.spend.polish, gain=0.005)

    def _hopeless(self, bones: int) -> bool:
        # with exact skinning the error falls abruptly at the right number of bones, so that a large
        # error just below it says nothing
        near = self.exact > 0 or (self.least > 1 and bones < _NEAR_RANK * self.least + 1)
        return not near and self.ladder.errors[bones] > self.spend.give_up * self.ladder.tolerance


def _climb(d: Descent) -> None:
    start_merged(d, 1.6)
    move_some(d, _MOVES)
    polish(d, steps=24, gain=0.01)


def _start_anew(d: Descent, factor: float, steps: int) -> None:
    start_merged(d, factor)
    polish(d, steps=steps, gain=0.005)
