"""The stage of search: whose turn it is, and when it gives up."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from helpers.blends import BONES, INFLUENCES, problem
from ssdr.search.prescribed import Prescribed
from ssdr.search.run import Run
from ssdr.search.stages import POLISH_STEPS_OF_A_TRY, Search
from ssdr.solver.model import FREE, Model
from ssdr.solver.trajectories import Trajectories


def new_run(data: Trajectories, stage: Search) -> Run:
    return Run(
        data,
        [stage],
        bones=BONES,
        influences=INFLUENCES,
        rng=np.random.default_rng(0),
        fixed=FREE,
        prescribed=Prescribed(),
    )


def test_changes_that_pay_have_more_turns() -> None:
    data, model = problem(6)
    run = new_run(data, Search(steps=400, patience=400))
    run.model = model
    memory = run.memory
    memory.turns, memory.misses = [-4, -3, -2, -1], [0] * 4
    for memory.count in range(8):
        kind = Search.next_change(run)
        assert kind == memory.count % 4
        memory.turns[kind] = memory.count
    drawn = []
    for memory.count in range(8, 400):
        kind = Search.next_change(run)
        memory.turns[kind], memory.misses[kind] = memory.count, 0 if kind == 2 else 3
        drawn.append(kind)
    share = np.bincount(drawn, minlength=4) / len(drawn)
    # three times as many, and none is given up for good
    assert share[2] == pytest.approx(1 / 2, abs=0.01)
    assert np.delete(share, 2) == pytest.approx([1 / 6] * 3, abs=0.01)


def searched(
    model: Model, data: Trajectories, stage: Search, leader: list[float]
) -> tuple[int, Run]:
    """How many tries a search makes beside another's track, and its run."""
    run = new_run(data, stage)
    run.model, run.leader = model.copy(), leader
    run.drive()
    return run.iteration // POLISH_STEPS_OF_A_TRY, run


def test_a_search_that_is_well_behind_another_gives_up() -> None:
    data, model = problem(6)
    op = Search(steps=7, patience=7, race=(1.08, 1.02))
    tries, alone = searched(model, data, op, [])
    own = alone.leader
    assert tries == len(own) - 1 == 7
    assert own[0] == pytest.approx(alone.value(model), rel=1e-12)
    assert (np.diff(own) <= 0).all()
    assert own[-1] == pytest.approx(alone.value(alone.best), rel=1e-12)
    # once each change had its turn, and not because of a little
    ahead = [value / 1.03 for value in own]
    tries, run = searched(model, data, op, ahead)
    assert tries == 4
    assert run.leader is ahead
    assert searched(model, data, op, [value / 1.01 for value in own])[0] == 7
    assert searched(model, data, op, ahead[:4])[0] == 7
    assert searched(model, data, dataclasses.replace(op, race=(0.0, 0.0)), ahead)[0] == 7
    # before the first try where it begins further behind than tries have made up for
    for ratio, tries in ((1.09, 0), (1.07, 4)):
        assert searched(model, data, op, [value / ratio for value in own])[0] == tries
    # the lowest end leads
    behind = [value * 1.01 for value in own]
    assert searched(model, data, op, behind)[1].leader == own
