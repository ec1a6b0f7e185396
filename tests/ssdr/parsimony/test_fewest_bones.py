"""The search for the fewest bones: on the way down, cancelled, resumed, limited."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ssdr
from helpers.measures import wavy
from ssdr.parsimony.fewest_bones import FewestBones
from ssdr.parsimony.report import Attempt


def test_progress_and_cancel() -> None:
    calls: list[Any] = []
    ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", callback=calls.append)
    shares = [p.fraction for p in calls]
    assert shares == sorted(shares)
    assert shares[0] >= 0
    assert shares[-1] <= 1
    assert [p.iteration for p in calls] == sorted(p.iteration for p in calls)
    assert any(np.isfinite(p.rmse) for p in calls)
    with pytest.raises(ssdr.Cancelled):
        ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", callback=lambda p: True)


def test_cancelled_and_resumed(tmp_path: Path) -> None:
    def holds(progress: Any) -> bool:
        return bool(np.isfinite(progress.rmse))

    first = ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", callback=holds)
    assert first.stop_reason == "cancelled"
    assert first.parsimony is not None
    assert first.parsimony.held  # the smallest so far that holds is handed out
    path = first.state.save(tmp_path / "state.npz")
    done = ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", resume=path)
    assert done.stop_reason == "tolerance held"
    assert done.skinning.n_bones <= first.skinning.n_bones
    assert done.parsimony is not None
    assert done.parsimony.attempts[0].start == "resumed"
    assert done.history[-1].elapsed > first.history[-1].elapsed
    for change in (
        {"tolerance": "0.7%"},
        {"influences": 3},
        {"sequence": 2 * wavy()},
        {"rest_frame": 1},
    ):
        arguments = {"sequence": wavy(), "tolerance": "0.8%", "effort": "fast"} | change
        with pytest.raises(ssdr.InputError) as caught:
            ssdr.decompose(**arguments, resume=path)
        assert caught.value.argument == "resume"
    with pytest.raises(ssdr.InputError):
        ssdr.decompose(wavy(), bones=4, effort="fast", resume=path)
    best = first.state.best
    assert best is not None
    cut = dataclasses.replace(best, transforms=best.transforms[1:])
    for change, message in (
        ({"progress": {}}, "damaged"),
        ({"progress": first.state.progress | {"rng": {"state": 1}}}, "damaged"),
        ({"progress": first.state.progress | {"iteration": []}}, "damaged"),
        ({"best": cut}, "other sizes"),
    ):
        other = dataclasses.replace(first.state, **change)
        with pytest.raises(ssdr.InputError, match=message) as caught:
            ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", resume=other)
        assert caught.value.argument == "resume"


@pytest.mark.parametrize(
    ("limit", "reason"),
    [({"max_iterations": 1}, "iterations"), ({"time_limit": 1e-6}, "time limit")],
)
def test_limits_hand_out_a_model(limit: dict[str, Any], reason: str) -> None:
    with pytest.warns(ssdr.SsdrWarning, match=rf"stopped \({reason}\) before tolerance"):
        result = ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", **limit)
    assert result.stop_reason == reason
    assert np.isfinite(result.rmse)


class _Oracle(FewestBones):
    """The search over numbers of bones alone: each try holds or fails as drawn."""

    def __init__(self, least: int, held: int, failed: set[int], luck: Any) -> None:
        self.least, self.luck, self.made = least, luck, 0
        self.held: Any = SimpleNamespace(n_bones=held, with_restarted_support=SimpleNamespace)
        self.attempts = [Attempt(b, 2.0, 0, "start") for b in failed]
        self.given_up: list[int] = []

    def _removable(self, model: Any) -> int:
        return int(self.luck(1, 4))

    def _outcome(self, bones: int, holds: bool) -> None:
        self.made += 1
        assert self.made < 500
        assert self.least <= bones < self.held.n_bones
        if holds:
            self.held = SimpleNamespace(n_bones=bones, with_restarted_support=SimpleNamespace)

    def _try(self, bones: int, *_: Any) -> Any:
        self._outcome(bones, self.luck(0, 1) == 1)
        return None, 2.0

    def _insist(self, bones: int, *_: Any) -> None:
        self._outcome(bones, self.luck(0, 2) == 2)
        if self.held.n_bones > bones:
            self.given_up.append(bones)

    tries = SimpleNamespace(polish=1)  # type: ignore[assignment]


@settings(max_examples=200, deadline=None)
@given(data=st.data(), least=st.integers(1, 4), held=st.integers(5, 30))
def test_merging_down_ends_one_above_what_was_given_up(data: Any, least: int, held: int) -> None:
    """Whatever fails or holds, also where what failed once holds later."""
    failed = data.draw(st.sets(st.integers(least, held - 1)))
    search = _Oracle(least, held, failed, lambda a, b: data.draw(st.integers(a, b)))
    search._shrink()
    end = search.held.n_bones
    assert end == least or search.given_up == [end - 1]
