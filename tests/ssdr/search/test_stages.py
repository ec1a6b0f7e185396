"""The stage of search: whose turn it is, and when it ends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from helpers.blends import BONES, INFLUENCES, problem
from helpers.measures import run_of
from ssdr.search.run import Run
from ssdr.search.stages import STEPS_OF_A_TRIAL, Search
from ssdr.solver.model import Model


def searched(paying: set[int], *, steps: int, patience: int = 400) -> tuple[list[int], Run]:
    """Which of four changes were tried, where those named lower the objective by 1 %."""
    data, model = problem(6)
    drawn: list[int] = []

    def change(kind: int) -> Any:
        def changed(_: object, model: Model, *others: object) -> Model:
            drawn.append(kind)
            return model.copy()

        return changed

    class Counted(Search):
        changes = tuple(change(kind) for kind in range(4))

        def polished_value(self, run: Run, trial: Model, base: float) -> float:
            trial.error *= 0.99 if drawn[-1] in paying else 1.01
            return run.value(trial)

    run = run_of(data, [Counted(steps=steps, patience=patience)], BONES, INFLUENCES)
    run.model = model
    run.drive()
    assert run.iteration == STEPS_OF_A_TRIAL * len(drawn)
    successes = sum(kind in paying for kind in drawn)
    assert run.value(run.present) == pytest.approx(0.99**successes * run.value(model), rel=1e-9)
    return drawn, run


def test_changes_that_pay_have_more_turns() -> None:
    drawn, _ = searched({0, 1, 2, 3}, steps=40)
    assert drawn == 10 * [0, 1, 2, 3]
    drawn, _ = searched({2}, steps=400)
    share = np.bincount(drawn[40:], minlength=4) / 360
    # seven times as many, and none is given up for good
    assert share[2] == pytest.approx(0.7, abs=0.01)
    assert np.delete(share, 2) == pytest.approx([0.1] * 3, abs=0.01)


@pytest.mark.parametrize("patience", [1, 3, 7])
def test_a_search_ends_after_so_many_failures_in_a_row(patience: int) -> None:
    drawn, run = searched(set(), steps=20, patience=patience)
    assert len(drawn) == patience
    assert run.converged
    # a success begins the count anew: each fourth trial is one
    drawn, run = searched({0}, steps=20, patience=4)
    assert len(drawn) == 20
    assert not run.converged
