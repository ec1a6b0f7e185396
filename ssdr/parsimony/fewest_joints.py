"""The fewest bones that hold a tolerance while they hang on joints."""

from __future__ import annotations

import numpy as np

from ..drivers.schedule import Schedule, tree_start
from ..joints.changes import loss_of_bones
from ..joints.stages import GiveUp, SearchTrees
from ..search.sampling import Recall
from ..search.stages import Polish
from ..solver.model import Model
from ..solver.trajectories import Array
from .fewest_bones import FewestBones, polish_stage

__all__ = ["FewestJoints"]

_FEW = 4  # tries of a short search for a better tree
_STARTS = 3  # new starts at most: each finds a tree anew


class FewestJoints(FewestBones):
    """The search of :class:`FewestBones` over trees: bones are given up, trees are searched."""

    rigid_joints = True

    def _begin(self, factor: float) -> Schedule:
        return (*tree_start(factor), Polish(steps=12, gain=0.01), Recall())

    def _settle(self) -> Schedule:
        return (_search(_FEW), Polish(steps=24, gain=0.01))

    def _merge(self) -> Schedule:
        return (GiveUp(),)

    def _costs(self, model: Model) -> Array:
        return np.array([loss.cost for loss in loss_of_bones(self.data, model)])

    def _insisting(self) -> Schedule:
        return (Recall(), polish_stage(30), _search(self.tries.rounds))

    def _other_starts(self, bones: int, model: Model) -> list[tuple[str, Schedule, Model | None]]:
        work: list[tuple[str, Schedule, Model | None]] = []
        if self.tries.reseeds:
            searched = (Recall(), _search(_FEW), polish_stage(self.tries.polish))
            work.append(("another tree", searched, model))
        for factor in self.tries.starts[:_STARTS]:
            work.append(("new start", (*self._begin(factor), polish_stage(8)), None))
        return work


def _search(tries: int) -> SearchTrees:
    return SearchTrees(steps=tries, patience=tries)
