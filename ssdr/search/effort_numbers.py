"""Numbers by effort for given bones, trees and smooth weights; numbers of rebuilds of "best".

Those of free bones stand in ``schedules.py``, where they are used.  Rebuilds depend on the size of
the problem: vertices × frames × bones.
"""

from __future__ import annotations

import dataclasses
import math

from .problem import Effort


@dataclasses.dataclass(frozen=True, kw_only=True)
class Numbers:
    """Numbers of steps, starts and trials where bones are given, joined or smooth.

    Attributes
    ----------
    polish : int
        Polish steps at the end if the caller gave bones or weights.
    smooth : int
        Most alternations under a smoothness penalty.
    trees : int
        Number of trees made from different starts; that of lowest objective is continued.
    limbs : int
        Number of starts from the motion on a skeleton without weights.
    weight_trials : int
        Trials of a search for better weights on a skeleton.
    rounds : int
        How many times the weights on a skeleton are relaxed and searched.
    """

    polish: int
    smooth: int
    trees: int
    limbs: int
    weight_trials: int
    rounds: int


NUMBERS: dict[Effort, Numbers] = {
    "fast": Numbers(polish=10, smooth=20, trees=1, limbs=1, weight_trials=0, rounds=0),
    "balanced": Numbers(polish=40, smooth=100, trees=3, limbs=1, weight_trials=4, rounds=1),
    "best": Numbers(polish=120, smooth=400, trees=6, limbs=4, weight_trials=16, rounds=3),
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Rebuilds:
    """Numbers of rebuilds, starts and trials of the effort "best" for problems of one size.

    Attributes
    ----------
    trials : int
        Trials of the search after a start, and of the last search.
    before, after : int
        How often the best model is rebuilt before and after the merged start.
    trees : int
        Number of trees made for free bones, which start from the tree of lowest objective as well.
    tree_searches : int
        How many times several trees are made and the best of them is searched.
    """

    trials: int
    before: int
    after: int
    trees: int
    tree_searches: int


# Chosen on a dozen sequences.  If a rebuild takes only seconds, the first model is rebuilt six
# times before the merged start (error of ea_bone with 5 bones: 3.95, against 4.48 without).  Larger
# problems have fewer rebuilds because each takes long.
REBUILDS = (  # size below which the numbers hold, and the numbers
    (2e6, Rebuilds(trials=10, before=6, after=6, trees=6, tree_searches=6)),
    (1e7, Rebuilds(trials=10, before=0, after=4, trees=1, tree_searches=4)),
    (math.inf, Rebuilds(trials=6, before=0, after=3, trees=1, tree_searches=3)),
)
TRIALS_OF_A_REBUILD = 6
# Fewest vertices per bone in a sample on which influences are relaxed; 60 are overfitted.
RELAXED_VERTICES = 128
# From this number of bones on there are several starts with few trials each, because alternations
# alone put many bones in better places, and after some starts no rebuild helps.
MANY_BONES, STARTS_OF_MANY_BONES, TRIALS_OF_A_START = 24, 3, 4
# The tree of lowest objective is relaxed and searched six times, each time with two trials of each
# change.  The error E of cow_elastic with 24 bones is then 7.14, against 7.36 after one search with
# 24 to 48 trials.
TREE_ROUNDS, TRIALS_OF_A_TREE = 6, 12


def rebuilds(size: float) -> Rebuilds:
    """Numbers of rebuilds, starts and trials of the effort "best" for a problem of this size."""
    return next(numbers for bound, numbers in REBUILDS if size < bound)
