"""The search for the fewest bones: its bound, its steps, stopped and resumed."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import motions
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measures import rmse_of, solved, wavy

import ssdr
from ssdr.parsimony.fewest_bones import FewestBones
from ssdr.parsimony.rank import rank_bound, reduced
from ssdr.parsimony.report import Attempt
from ssdr.search.moves import grow_bone
from ssdr.solver.model import Fixed
from ssdr.solver.trajectories import gather


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1000), bones=st.integers(1, 4))
def test_no_model_is_below_the_rank_bound(seed: int, bones: int) -> None:
    rng = np.random.default_rng(seed)
    rest = rng.uniform(-1, 1, (40, 3))
    frames = motions.random_skinning(rng, rest, 9, bones, 3)
    frames += 1e-3 * rng.standard_normal(frames.shape)
    data = gather([ssdr.MeshSequence(frames)], bones=40)
    model = solved(data, bones)
    error = model.objective(data)
    assert rank_bound(data, error) <= bones
    # the bound itself, from the frames by a plain SVD of what is left without the centroids
    centred = (frames - frames.mean(axis=1, keepdims=True)).transpose(1, 0, 2).reshape(40, -1)
    values = np.linalg.svd(centred / data.scale, compute_uv=False) ** 2
    left = values.sum() - np.concatenate([[0], np.cumsum(values)])
    rank = int(np.argmax(left <= error))
    assert rank_bound(data, error) == max(1, -(-(rank + 1) // 4))


@pytest.mark.parametrize("shape", [(30, 40), (6, 90)])
def test_reduction_keeps_what_the_tolerance_sees(shape: tuple[int, int]) -> None:
    n_frames, n = shape
    rng = np.random.default_rng(0)
    low = rng.standard_normal((n, 4)) @ rng.standard_normal((4, 3 * n_frames))
    frames = low.reshape(n, n_frames, 3).transpose(1, 0, 2)
    frames = frames + 1e-4 * rng.standard_normal(frames.shape)
    data = gather([ssdr.MeshSequence(frames)], bones=n)
    less = reduced(data, 1e-2 * float(data.x2.sum()))
    assert less.z.shape[1] < data.z.shape[1]
    assert less.q is not None
    assert np.abs(less.q.T @ less.q - np.eye(less.q.shape[1])).max() < 1e-10
    whole = data.z if data.q is None else data.z @ data.q.T
    lost = float(((whole - less.z @ less.q.T) ** 2).sum())
    assert lost == pytest.approx(less.lost, rel=1e-6, abs=1e-12)
    assert lost <= 1e-6 * float(data.x2.sum())


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1000), bones=st.integers(1, 5), influences=st.integers(1, 4))
def test_one_bone_more_never_fits_worse(seed: int, bones: int, influences: int) -> None:
    rng = np.random.default_rng(seed)
    frames = rng.standard_normal((5, 30, 3)) + 2 * rng.standard_normal((1, 30, 3))
    data = gather([ssdr.MeshSequence(frames)], bones=8)
    model = solved(data, bones, influences)
    grown = grow_bone(data, model, alternations=2, fixed=Fixed())
    assert grown.n_bones == bones + 1
    assert grown.n_influences == model.n_influences
    assert grown.objective(data) <= model.objective(data)
    rest, transforms = data.to_world(grown.rest, grown.transforms)
    built = ssdr.Skinning(rest, grown.joints, grown.weights, transforms)
    measured = rmse_of(built, frames)
    said = data.scale * np.sqrt(max(grown.objective(data), 0.0) / (5 * 30))
    assert measured == pytest.approx(said, rel=1e-6, abs=1e-9)


def test_progress_and_cancel() -> None:
    told: list[Any] = []
    ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", callback=told.append)
    shares = [p.fraction for p in told]
    assert shares == sorted(shares)
    assert shares[0] >= 0
    assert shares[-1] <= 1
    assert [p.iteration for p in told] == sorted(p.iteration for p in told)
    assert any(np.isfinite(p.rmse) for p in told)
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
)  # fmt: skip
def test_limits_hand_out_a_model(limit: dict[str, Any], reason: str) -> None:
    with pytest.warns(ssdr.SsdrWarning, match=rf"stopped \({reason}\) before tolerance"):
        result = ssdr.decompose(wavy(), tolerance="0.8%", effort="fast", **limit)
    assert result.stop_reason == reason
    assert np.isfinite(result.rmse)


class _Oracle(FewestBones):
    """The search over numbers of bones alone: tries hold or fail as they are told."""

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
