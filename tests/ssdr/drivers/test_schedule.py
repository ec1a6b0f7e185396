"""The schedule of each effort."""

from __future__ import annotations

import pytest

from ssdr.drivers.schedule import Schedule, schedule_for
from ssdr.search.prescribed import Prescribed
from ssdr.search.stages import Merge, Regrow, Search, Start
from ssdr.solver.model import FREE


def best_schedule(bones: int, size: float) -> Schedule:
    return schedule_for(
        "best", fixed=FREE, bones=bones, prescribed=Prescribed(), smoothed=False, size=size
    )


def tries(schedule: Schedule) -> int:
    return sum(stage.steps for stage in schedule if isinstance(stage, Search))


@pytest.mark.parametrize("size", [1e5, 8e6, 1.5e7, 1e9])
def test_best_rebuilds_and_begins_with_regrown_starts_where_bones_are_many(size: float) -> None:
    few, many = best_schedule(23, size), best_schedule(24, size)
    for schedule, starts in ((few, 0), (many, 3)):
        begun = [stage for stage in schedule if type(stage) is Start]
        # the last of them as of "balanced", with draws of its own
        assert [stage.branch for stage in begun] == starts * [False] + [True]
        assert sum(stage.branch and isinstance(stage, Merge) for stage in schedule) == 1
        regrown = [(k, stage) for k, stage in enumerate(schedule) if isinstance(stage, Regrow)]
        assert sum(stage.patience > 0 for _, stage in regrown) == starts
        rebuilt = [k for k, stage in regrown if not stage.patience]
        for k in rebuilt:
            # of the best model, and judged only once influences and weights have followed
            phases = [stage.phase for stage in schedule[k - 1 : k + 4]]
            assert phases == ["recall", "regrow", "relax", "polish", "search"]
            search = schedule[k + 3]
            assert isinstance(search, Search)
            assert min(search.race) > 1
        assert len(rebuilt) == sum(
            isinstance(stage, Regrow) and not stage.patience for stage in few
        )
        assert schedule[-2].phase == "recall"
    assert tries(few) >= tries(best_schedule(23, 2 * size))


@pytest.mark.parametrize(("size", "rebuilt"), [(1e5, True), (3e6, False), (1e9, False)])
def test_small_models_are_rebuilt_before_another_start_is_set_beside_them(
    size: float, rebuilt: bool
) -> None:
    schedule = best_schedule(5, size)
    merged = next(k for k, stage in enumerate(schedule) if stage.branch)
    before, after = schedule[:merged], schedule[merged:]
    assert any(isinstance(stage, Regrow) for stage in before) == rebuilt
    assert any(isinstance(stage, Regrow) for stage in after)
