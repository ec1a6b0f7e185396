"""The schedule of each effort."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.measures import descent_of
from ssdr.search.descent import Descent
from ssdr.search.effort_numbers import REBUILDS
from ssdr.search.schedules import follow_effort
from ssdr.solver.trajectories import gather


def planning(bones: int) -> Descent:
    """A descent that makes no steps, but lists their phases and numbers."""
    frames = np.random.default_rng(0).random((2, 30, 3))
    d = descent_of(gather([ssdr.MeshSequence(frames)], bones=bones), bones)
    d.work.plan = []
    return d


def planned(effort: Any, rig: Any = "none", bones: int = 6) -> list[tuple[str, int]]:
    """The steps of an effort."""
    d = planning(bones)
    follow_effort(d, effort=effort, rig=rig, bones_placed=False, tries_model=False)
    assert d.work.plan is not None
    return d.work.plan


def phases(listed: list[tuple[str, int]]) -> list[str]:
    return [phase for phase, _ in listed]


def test_best_makes_all_steps_of_balanced_before_others() -> None:
    first, best = planned("balanced"), planned("best")
    assert best[: len(first)] == first
    assert phases(best)[-3:] == ["whole parts", "unfold", "unfold"]


def test_a_rebuild_is_of_the_best_model_and_judged_once_weights_have_followed() -> None:
    listed = phases(planned("best"))
    rebuilt = [k for k, phase in enumerate(listed) if phase == "add and merge"]
    assert len(rebuilt) == REBUILDS
    for k in rebuilt:
        expected = ["return to best", "add and merge", "relax", "polish", "search"]
        assert listed[k - 1 : k + 4] == expected


@pytest.mark.parametrize("effort", ["fast", "balanced", "best"])
@pytest.mark.parametrize("rig", ["none", "rigid"])
def test_normals_count_from_the_last_polish_on(effort: Any, rig: Any) -> None:
    """With "best" from the last polish of "balanced" on, but for its search on a sample."""
    listed = phases(planned(effort, rig))
    assert listed.count("normals") == 1
    after = [p for p in listed[listed.index("normals") + 1 :] if p != "whole parts"]
    assert after[:2] == ["polish", "unfold"]


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
