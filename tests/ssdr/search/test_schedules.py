"""The schedule of each effort."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.measures import descent_of
from ssdr.search.descent import Descent
from ssdr.search.schedules import best_bones, follow_effort
from ssdr.solver.trajectories import gather


def planning(bones: int) -> Descent:
    """A descent that makes no steps, but lists their phases and numbers."""
    frames = np.random.default_rng(0).random((2, 30, 3))
    d = descent_of(gather([ssdr.MeshSequence(frames)], bones=bones), bones)
    d.work.plan = []
    return d


def best_schedule(bones: int, size: float) -> list[tuple[str, int]]:
    d = planning(bones)
    best_bones(d, size, stretching=False)
    assert d.work.plan is not None
    return d.work.plan


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
    d = planning(6)
    follow_effort(d, effort=effort, rig=rig, bones_placed=False, tries_model=False)
    assert phases(d.work.plan)[-3:] == ["normals", "polish", "unfold"]
    assert phases(d.work.plan).count("normals") == 1


@pytest.mark.parametrize("rest_pose", ["surface", "free"])
def test_no_piece_is_torn_where_two_share_a_bone(rest_pose: str) -> None:
    """With one influence, a piece of two bones would come apart."""
    exact = motions.pieces(16, seed=2)
    options = {"influences": 1, "effort": "fast", "rest_pose": rest_pose}
    found = ssdr.decompose(exact.frames, exact.faces, bones=9, **options)
    owner = found.skinning.indices.reshape(16, 8)
    assert (owner == owner[:, :1]).all()
    assert len(np.unique(owner)) == 9
    assert found.rmse > 0


def test_smooth_weights_of_many_frames_of_low_rank() -> None:
    """The search without the penalty, amid one with it, begins from compressed frames."""
    few = ssdr.samples.load("dancer_small").vertices[:3, ::4]
    way = np.abs(np.linspace(-2, 2, 130))[:, None, None]
    frames = few[0] * (1 - way) + few[1] * way
    faces = np.arange(3 * (few.shape[1] // 3)).reshape(-1, 3)
    result = ssdr.decompose(frames, faces, bones=2, smoothness=0.01)
    assert np.isfinite(result.rmse)
