"""The schedule of each effort."""

from __future__ import annotations

import pytest

from ssdr.drivers.schedule import schedule_for
from ssdr.search.given import Given
from ssdr.search.run import Schedule
from ssdr.search.stages import AddAndMerge, Merge, Search
from ssdr.search.starts import StartFromMotion


def best_schedule(bones: int, size: float) -> Schedule:
    call = {"bone_model": "rigid", "given": Given(), "placed": False, "smoothed": False}
    return schedule_for("best", bones=bones, size=size, **call)


def trials(schedule: Schedule) -> int:
    return sum(stage.steps for stage in schedule if isinstance(stage, Search))


@pytest.mark.parametrize("size", [1e5, 8e6, 1.5e7, 1e9])
def test_best_rebuilds_and_begins_with_several_starts_where_bones_are_many(size: float) -> None:
    few, many = best_schedule(23, size), best_schedule(24, size)
    for schedule, starts in ((few, 0), (many, 3)):
        begun = [stage.factor for stage in schedule if type(stage) is StartFromMotion]
        # the last of them as of "balanced", with bones to merge away
        assert begun == starts * [1.0] + [1.6]
        assert sum(isinstance(stage, Merge) for stage in schedule) == 1
        added = [(k, stage) for k, stage in enumerate(schedule) if isinstance(stage, AddAndMerge)]
        assert sum(stage.patience > 0 for _, stage in added) == starts
        rebuilt = [k for k, stage in added if not stage.patience]
        for k in rebuilt:
            # of the best model, and judged only once influences and weights have followed
            phases = [stage.phase for stage in schedule[k - 1 : k + 4]]
            assert phases == ["return to best", "add and merge", "relax", "polish", "search"]
        assert len(rebuilt) == sum(isinstance(stage, AddAndMerge) for stage in few)
        assert schedule[-2].phase == "return to best"
    assert trials(few) >= trials(best_schedule(23, 2 * size))


@pytest.mark.parametrize(("size", "rebuilt"), [(1e5, True), (3e6, False), (1e9, False)])
def test_small_models_are_rebuilt_before_another_start_is_set_beside_them(
    size: float, rebuilt: bool
) -> None:
    schedule = best_schedule(5, size)
    merged = next(k for k, stage in enumerate(schedule) if isinstance(stage, Merge))
    before, after = schedule[:merged], schedule[merged:]
    assert any(isinstance(stage, AddAndMerge) for stage in before) == rebuilt
    assert any(isinstance(stage, AddAndMerge) for stage in after)
