"""The fewest bones that hold a tolerance.

    climb      new starts of ever more bones, from a proven bound, until one holds
    descend    merge bones away; where the next smaller number fails, refine it
    refine     new starts of that number of bones, then a long search around the lowest

An attempt ends as soon as it holds the tolerance.
"""

from __future__ import annotations

import dataclasses
import math

from ..drivers.efforts import Effort
from ..search.stages import Polish
from .ladder import Ladder

__all__ = ["Bounds", "FewestBones"]

_GROWTH = 1.5  # the next number of bones, relative to one that failed
_NEAR_RANK = 1.5  # times the proven bound, below which a far miss may still be a bad minimum
_MOVES = 6  # of bones, or changes of the tree, of a short search


@dataclasses.dataclass(frozen=True)
class Refinement:
    """What is tried of a number of bones before it is given up.

    Attributes
    ----------
    polish : int
        Most polish steps of a merged model.
    starts : tuple of float
        Bones of each new start, relative to those asked for.
    moves, trials : int
        Bones that are moved, and trials, of the search around the lowest model.
    give_up : float
        Error, relative to the tolerance, of a number of bones that is not searched for long.
    """

    polish: int
    starts: tuple[float, ...]
    moves: int
    trials: int
    give_up: float


REFINEMENT: dict[Effort, Refinement] = {
    "fast": Refinement(polish=6, starts=(), moves=6, trials=0, give_up=1.1),
    "balanced": Refinement(polish=12, starts=(1.6, 2.2, 3.0), moves=24, trials=8, give_up=1.3),
    "best": Refinement(
        polish=20, starts=(1.6, 2.2, 3.0, 1.3, 1.9, 2.6), moves=60, trials=30, give_up=1.6
    ),
}


@dataclasses.dataclass(frozen=True)
class Bounds:
    """What is known of the number of bones before the search.

    Attributes
    ----------
    least : int
        No model of fewer bones holds the tolerance: proven.
    most : int
    exact : int
        Most bones of an exact skinning whose bones share joints; 0 where the rank of the motion
        does not say that it is one.
    """

    least: int
    most: int
    exact: int


class FewestBones:
    """The search, on a ladder that keeps what it finds.

    Parameters
    ----------
    ladder : Ladder
    bounds : Bounds
    effort : {"fast", "balanced", "best"}
    """

    def __init__(self, ladder: Ladder, bounds: Bounds, effort: Effort) -> None:
        self.ladder, self.bounds, self.spend = ladder, bounds, REFINEMENT[effort]

    def run(self) -> None:
        """Fill the ladder until a number of bones holds and the next smaller one does not."""
        if self.ladder.fewest is None:
            self.climb()
        if self.ladder.fewest is not None:
            self.descend()

    def climb(self) -> None:
        """New starts of ever more bones until one holds the tolerance."""
        ladder = self.ladder
        least, most, exact = self.bounds.least, self.bounds.most, self.bounds.exact
        bones = least
        while True:
            polish = Polish(steps=24, gain=0.01)
            schedule = (*ladder.stages.start(1.6), *ladder.stages.move(_MOVES), polish)
            ladder.attempt(bones, schedule, "start", part=(0.0, 0.25))
            if (bones == most or least < bones == exact) and not ladder.fits(bones):
                self.refine(bones)
            if ladder.fewest is not None or bones >= most:
                return
            larger = max(bones + 1, math.ceil(_GROWTH * bones))
            # an exact skinning is not passed over
            bones = min(most, exact if bones < exact < larger else larger)

    def descend(self) -> None:
        """Merge down between what failed and what holds; refine where they touch."""
        ladder, least = self.ladder, self.bounds.least
        low = max((b for b in ladder.errors if b < self._held), default=least - 1)
        while (held := self._held) > least:
            bones = max((low + held) // 2, least) if held - low > 1 else held - 1
            schedule = (*ladder.stages.merge(), Polish(steps=self.spend.polish, gain=0.005))
            wide = ladder.models[held].with_restarted_support()
            ladder.attempt(bones, schedule, "merged", start=wide, part=(0.25, 0.4))
            if not ladder.fits(bones) and held - bones > 1:
                low = bones
                continue
            if not ladder.fits(bones):
                self.refine(bones)
            if not ladder.fits(bones):
                return
            if self._held <= low + 1:  # what failed before was not tried as hard
                low = max(least - 1, self._held - 2)

    @property
    def _held(self) -> int:
        held = self.ladder.fewest
        assert held is not None
        return held

    def refine(self, bones: int) -> None:
        """Try what the effort allows before a number of bones is given up."""
        ladder, stages, spend = self.ladder, self.ladder.stages, self.spend
        lowest = ladder.models[bones].with_restarted_support()
        improve = (*stages.move(_MOVES), Polish(steps=spend.polish, gain=0.005))
        ladder.attempt(bones, improve, "improved", start=lowest, part=(0.4, 0.5))
        for k, factor in enumerate(spend.starts):
            if ladder.fits(bones) or self._hopeless(bones):
                return
            schedule = (*stages.start(factor), Polish(steps=8, gain=0.005))
            part = 0.5 + 0.2 * k / len(spend.starts)
            ladder.attempt(bones, schedule, "new start", part=(part, part))
        if ladder.fits(bones) or self._hopeless(bones) or not spend.trials:
            return
        lowest = ladder.models[bones].with_restarted_support()
        search = stages.search(spend.moves, spend.trials)
        ladder.attempt(bones, search, "searched", start=lowest, part=(0.7, 0.9))

    def _hopeless(self, bones: int) -> bool:
        # exact skinning has no slope that says how far there is to go
        least = self.bounds.least
        near = self.bounds.exact > 0 or (least > 1 and bones < _NEAR_RANK * least + 1)
        return not near and self.ladder.errors[bones] > self.spend.give_up * self.ladder.tolerance
