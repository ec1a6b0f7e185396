"""Numbers by effort for given bones, trees and smooth weights; numbers of starts of "best".

Those of free bones stand in ``schedules.py``, where they are used.
"""

from __future__ import annotations

import dataclasses

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


# How often "best" rebuilds the best model; trials of a search, of all vertices and after a rebuild.
REBUILDS, TRIALS_OF_ALL, TRIALS_OF_A_REBUILD = 3, 4, 6
# Fewest vertices per bone in a sample on which influences are relaxed; 60 are overfitted.
RELAXED_VERTICES = 128
# How many times several trees are made and the best of them is searched.
TREE_SEARCHES = 4
# The tree of lowest objective is relaxed and searched six times, each time with two trials of each
# change.  The error E of cow_elastic with 24 bones is then 7.14, against 7.36 after one search with
# 24 to 48 trials.
TREE_ROUNDS, TRIALS_OF_A_TREE = 6, 12
