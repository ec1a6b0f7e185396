"""The search for the fewest bones: on the way down, cancelled, resumed, limited."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ssdr
from helpers.measures import wavy
from ssdr.parsimony import fewest_bones
from ssdr.parsimony.fewest_bones import Bounds, descend


def test_progress_and_cancel() -> None:
    calls: list[Any] = []
    ssdr.smallest(wavy(), tolerance="0.8%", effort="fast", callback=calls.append)
    shares = [p.fraction for p in calls]
    assert shares == sorted(shares)
    assert shares[0] >= 0
    assert shares[-1] <= 1
    assert [p.iteration for p in calls] == sorted(p.iteration for p in calls)
    assert any(np.isfinite(p.rmse) for p in calls)
    with pytest.raises(ssdr.Cancelled):
        ssdr.smallest(wavy(), tolerance="0.8%", effort="fast", callback=lambda p: True)


def test_cancelled_and_continued_from_the_checkpoint(tmp_path: Path) -> None:
    def holds(progress: Any) -> bool:
        return bool(np.isfinite(progress.rmse))

    path = tmp_path / "model.npz"
    options = {"tolerance": "0.8%", "effort": "fast"}
    first = ssdr.smallest(wavy(), **options, callback=holds, checkpoint=path)
    assert first.stop_reason == "cancelled"
    assert first.parsimony.held  # the smallest so far that holds is handed out
    done = ssdr.smallest(wavy(), **options, start=ssdr.load_skinning(path))
    assert done.stop_reason == "tolerance held"
    assert done.skinning.n_bones <= first.skinning.n_bones


def test_a_time_limit_hands_out_a_model() -> None:
    with pytest.warns(ssdr.SsdrWarning, match=r"stopped \(time limit\) before"):
        result = ssdr.smallest(wavy(), tolerance="0.8%", effort="fast", time_limit=1e-6)
    assert result.stop_reason == "time limit"
    assert np.isfinite(result.rmse)


class _Models:
    """Numbers of bones alone: each attempt holds or fails as drawn."""

    def __init__(self, least: int, held: int, failed: set[int], luck: Any) -> None:
        self.least, self.luck, self.made, self.fewest = least, luck, 0, held
        model = SimpleNamespace(with_restarted_support=lambda: None)
        self.missed = SimpleNamespace(model=model, value=2.0)
        self.best = dict.fromkeys([*failed, held], self.missed)
        self.tolerance = 1.0

    @property
    def held_bones(self) -> int:
        return self.fewest

    def fits(self, bones: int) -> bool:
        return self.fewest <= bones

    def attempt(self, bones: int, *_: Any, **__: Any) -> None:
        self.made += 1
        assert self.made < 500
        assert self.least <= bones < self.fewest
        self.best[bones] = self.missed
        if self.luck(0, 2) == 2:
            self.fewest = bones


@settings(max_examples=200)
@given(data=st.data(), least=st.integers(1, 4), held=st.integers(5, 30))
def test_merging_down_ends_one_above_what_was_given_up(data: Any, least: int, held: int) -> None:
    """Whatever fails or holds, also where what failed once holds later."""
    failed = data.draw(st.sets(st.integers(least, held - 1)))
    models: Any = _Models(least, held, failed, lambda a, b: data.draw(st.integers(a, b)))
    refine, given_up = fewest_bones.refine, list[int]()

    def refined(models: Any, bones: int, *rest: Any) -> None:
        refine(models, bones, *rest)
        if not models.fits(bones):
            given_up.append(bones)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fewest_bones, "refine", refined)
        descend(models, Bounds(least, held, 0), "fast")
    end = models.fewest
    assert end == least or given_up == [end - 1]
