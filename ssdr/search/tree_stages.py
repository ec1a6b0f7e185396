"""The stages that bring bones onto joints and look for a better tree."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

import numpy as np

from ..solver.joints import hang, soft_step, spanning_tree
from ..solver.model import Model
from .moves import loosen, polish_steps, thin
from .run import Run, Stage
from .stages import POLISH_STEPS_OF_A_TRY, Change, Search
from .tree_moves import join_touching, reparent, replace_bone

__all__ = ["Hang", "SearchTrees"]

# Stiffness of the joints, of the lighter bone's mass, from the first step of a ramp to the last.
_RAMP = (1e-2, 100.0)
_MOST_POLISH = 48  # steps of a try that is still on its way below the model that it has to beat
_AHEAD = 4  # as many more blocks of steps as good as the last have to lead below it


@dataclasses.dataclass(frozen=True, kw_only=True)
class Hang(Stage):
    """A tree over free bones, to which they are brought by degrees; on the last step they hang.

    Attributes
    ----------
    steps : int
        Of the ramp of stiffness.
    """

    phase: ClassVar[str] = "hang"
    steps: int = 20
    cost: float = 1.5

    def step(self, run: Run) -> bool:
        at = run.memory.count
        if at == 0:
            run.model = run.present.with_influences(run.influences)
            run.model.tree = spanning_tree(run.model)
        model = run.present
        stiffness = np.geomspace(*_RAMP, self.steps)[at]
        soft_step(run.data, model, float(stiffness), run.fixed)
        run.iteration += 1
        if at == self.steps - 1:
            hang(run.data, model, run.fixed)
        return at == self.steps - 1


@dataclasses.dataclass(frozen=True, kw_only=True)
class SearchTrees(Search):
    """A search whose changes are those of trees.

    A better tree shows only after many steps: a try is polished on for as long as its last
    steps promise to lead below the model that it has to beat.
    """

    kinds: ClassVar[tuple[Change, ...]] = (join_touching, loosen, reparent, thin, replace_bone)
    changes: ClassVar[int] = len(kinds)

    def settle(self, run: Run, trial: Model, base: float) -> float:
        value = np.inf
        for steps in range(0, _MOST_POLISH, POLISH_STEPS_OF_A_TRY):
            before = value
            polish_steps(run.data, trial, POLISH_STEPS_OF_A_TRY, run.fixed)
            value = run.value(trial)
            if value < base or (steps and value - _AHEAD * (before - value) > base):
                break
        return value
