"""The schedule of each effort."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import ssdr
from ssdr.problem.initial import Given
from ssdr.search.descent import Descent
from ssdr.search.schedules import best_bones, follow_effort
from ssdr.solver.model import Locked
from ssdr.solver.trajectories import gather


class Listed(Descent):
    """A descent that makes no steps, but lists their phases and numbers."""

    def __init__(self, bones: int) -> None:
        frames = np.random.default_rng(0).random((2, 30, 3))
        data = gather([ssdr.MeshSequence(frames)], bones=bones)
        parts: dict[str, Any] = {"locked": Locked(), "given": Given(), "influences": 4}
        super().__init__(data, bones=bones, rng=np.random.default_rng(0), **parts)
        self.work.estimating, self.listed = True, list[tuple[str, int]]()

    def make_steps(self, steps: Any, phase: str, *, cost: float, count: int) -> None:
        self.listed.append((phase, count))


def best_schedule(bones: int, size: float) -> list[tuple[str, int]]:
    d = Listed(bones)
    best_bones(d, size, stretching=False)
    return d.listed


def phases(listed: list[tuple[str, int]]) -> list[str]:
    return [phase for phase, _ in listed]


def trials(listed: list[tuple[str, int]]) -> int:
    return sum(count for phase, count in listed if phase == "search")


@pytest.mark.parametrize("size", [1e5, 8e6, 1.5e7, 1e9])
def test_best_rebuilds_and_begins_with_several_starts_where_bones_are_many(size: float) -> None:
    few, many = best_schedule(23, size), best_schedule(24, size)
    for listed, starts in ((few, 0), (many, 3)):
        added = [k for k, (phase, _) in enumerate(listed) if phase == "add and merge"]
        assert sum(listed[k][1] > 1 for k in added) == starts
        rebuilt = [k for k in added if listed[k][1] == 1]
        for k in rebuilt:
            # of the best model, and judged only once influences and weights have followed
            expected = ["return to best", "add and merge", "relax", "polish", "search"]
            assert phases(listed)[k - 1 : k + 4] == expected
        assert len(rebuilt) == phases(few).count("add and merge")
        assert phases(listed)[-3:] == ["return to best", "normals", "polish"]
    assert trials(few) >= trials(best_schedule(23, 2 * size))


@pytest.mark.parametrize(("size", "rebuilt"), [(1e5, True), (3e6, False), (1e9, False)])
def test_small_models_are_rebuilt_before_another_start_is_set_beside_them(
    size: float, rebuilt: bool
) -> None:
    listed = phases(best_schedule(5, size))
    merged = len(listed) - listed[::-1].index("merge")
    assert ("add and merge" in listed[:merged]) == rebuilt
    assert "add and merge" in listed[merged:]


@pytest.mark.parametrize("effort", ["fast", "balanced", "best"])
@pytest.mark.parametrize("rig", ["none", "rigid"])
def test_normals_count_from_the_last_polish_on(effort: Any, rig: Any) -> None:
    d = Listed(6)
    follow_effort(d, effort=effort, rig=rig, placed=False, tries_model=False)
    assert phases(d.listed)[-3:] == ["normals", "polish", "unfold"]
    assert phases(d.listed).count("normals") == 1
