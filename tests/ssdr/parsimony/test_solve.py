"""The smallest model for a tolerance: what it promises, measured from outside."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ssdr
from helpers import motions
from helpers.measures import diagonal, largest_of, rmse_of, small, wavy
from ssdr.search import scan
from ssdr.search.progress import Monitor


@pytest.mark.slow
def test_a_rest_pose_is_a_surface_unless_it_is_free() -> None:
    dancer = ssdr.samples.load("dancer_small")
    edges = np.concatenate([dancer.faces[:, [0, 1]], dancer.faces[:, [1, 2]]])
    nearest = {}
    for kind in ("surface", "free"):
        found = ssdr.smallest(dancer, tolerance="0.5%", effort="fast", rest_pose=kind)
        assert found.parsimony.held
        own = np.diff(found.skinning.rest[edges], axis=1)
        others = np.diff(dancer.vertices[:, edges], axis=2)
        nearest[kind] = ((own - others) ** 2).sum(axis=(1, 2, 3)).min()
    assert nearest["surface"] < 0.3 * nearest["free"]


def test_a_static_mesh_gets_one_bone_one_influence_one_key() -> None:
    pose = np.random.default_rng(0).standard_normal((40, 3))
    result = ssdr.smallest(np.repeat(pose[None], 9, axis=0), tolerance="0.5%")
    assert result.skinning.transforms.shape == (9, 1, 3, 4)
    assert result.skinning.weights.shape == (40, 1)
    assert result.skinning.keyframes is not None
    assert result.skinning.keyframes.sum() == 1
    assert result.rmse < 1e-13
    assert result.stop_reason == "tolerance held"
    assert result.converged


def test_points_that_coincide_get_one_bone() -> None:
    frames = np.repeat(np.random.default_rng(0).standard_normal((6, 1, 3)), 10, axis=1)
    result = ssdr.smallest(frames, tolerance="0.5%")  # of a diagonal of zero
    assert result.skinning.n_bones == 1
    assert result.parsimony.held


@pytest.mark.parametrize("count", [2, 3])
def test_rigid_boxes_get_a_bone_each(count: int) -> None:
    rig = motions.boxes(count)
    result = ssdr.smallest(rig.frames, tolerance="0.01%")
    assert result.skinning.n_bones == count
    assert result.skinning.n_influences == 1
    bone = result.skinning.indices[:, 0].reshape(count, -1)
    assert (bone == bone[:, :1]).all()
    assert len(set(bone[:, 0])) == count


def test_pieces_get_a_bone_for_each_motion() -> None:
    exact = motions.pieces(11)
    exact.transforms[:, 4] = exact.transforms[:, 1]
    found = ssdr.smallest(exact.frames, exact.faces, tolerance="0.01%", effort="fast")
    assert found.skinning.n_bones == 10
    assert found.skinning.n_influences == 1


@pytest.mark.parametrize("tolerance", ["0.1%", "0.001%"])
def test_exact_skinning_gets_no_more_bones_than_it_was_made_with(tolerance: str) -> None:
    rig = motions.chain(bones=5, rows=14, frames=15)
    found = ssdr.smallest(rig.frames, tolerance=tolerance)
    assert found.skinning.n_bones <= 5
    assert found.parsimony.held
    if tolerance == "0.001%":
        assert found.skinning.n_bones == 5
        assert found.skinning.n_influences == 2  # as it was made


@settings(max_examples=5)
@given(seed=st.integers(0, 1000), bones=st.integers(1, 4))
def test_random_exact_skinning(seed: int, bones: int) -> None:
    rng = np.random.default_rng(seed)
    rest = rng.uniform(-1, 1, (60, 3))
    frames = motions.random_skinning(rng, rest, 10, bones, 2)
    result = ssdr.smallest(frames, tolerance="0.05%")
    assert result.skinning.n_bones <= bones
    assert rmse_of(result.skinning, frames) <= 5e-4 * diagonal(frames) * (1 + 1e-9)


@pytest.mark.parametrize("measure", ["rmse", "max"])
def test_the_tolerance_is_held_and_said(measure: Any) -> None:
    frames = wavy()
    result = ssdr.smallest(frames, tolerance="1.5%", measure=measure, effort="fast")
    found = result.parsimony
    rmse = rmse_of(result.skinning, frames)
    reached = rmse if measure == "rmse" else largest_of(result.skinning, frames)
    assert found.tolerance == pytest.approx(0.015 * diagonal(frames))
    assert reached <= found.tolerance
    assert found.held
    assert found.error == pytest.approx(reached, rel=1e-9)
    assert result.rmse == pytest.approx(rmse, rel=1e-9)
    assert result.history[-1].rmse == result.rmse
    assert found.measure == measure
    assert found.bones == result.skinning.n_bones
    assert found.influences == result.skinning.n_influences
    assert found.least_bones <= found.bones
    assert not result.warnings


def test_a_stricter_measure_never_gets_fewer_bones() -> None:
    loose = small().parsimony
    strict = ssdr.smallest(wavy(), tolerance="0.8%", measure="max", effort="fast").parsimony
    assert strict.bones > loose.bones


def test_bounds_on_bones_and_influences_are_kept() -> None:
    with pytest.warns(ssdr.SsdrWarning, match="out of reach"):
        few = ssdr.smallest(wavy(), tolerance="0.3%", bones=2, effort="fast")
    assert few.skinning.n_bones == 2
    one = ssdr.smallest(wavy(), tolerance="3%", influences=1, effort="fast")
    assert one.skinning.n_influences == 1
    assert one.parsimony.held
    exact = ssdr.smallest(wavy(), tolerance="0.8%", bones=small().skinning.n_bones, effort="fast")
    assert exact.skinning.n_bones == small().skinning.n_bones


def test_an_unreachable_tolerance_says_what_was_reached() -> None:
    with pytest.warns(ssdr.SsdrWarning) as caught:
        result = ssdr.smallest(wavy(), tolerance="0.001%", bones=2, effort="fast")
    (text,) = result.warnings
    assert str(caught[0].message) == text
    rmse = rmse_of(result.skinning, wavy())
    assert f"2 bones of at most 4 influences reach a RMSE of {rmse:.4g}" in text
    assert result.stop_reason == "tolerance out of reach"
    assert not result.converged
    assert not result.parsimony.held
    assert result.parsimony.prunings == ()


def test_size_and_place_of_the_mesh_do_not_matter() -> None:
    base = small().skinning
    moved = ssdr.smallest(1e3 * wavy() + 1e4, tolerance="0.8%", effort="fast").skinning
    assert moved.n_bones == base.n_bones


def test_several_shots_and_plain_arrays() -> None:
    shots = [ssdr.MeshSequence(wavy()[:6]), ssdr.MeshSequence(wavy()[6:])]
    result = ssdr.smallest(shots, tolerance="0.8%", effort="fast")
    assert result.offsets.tolist() == [0, 6, 15]
    assert rmse_of(result.skinning, wavy()) <= 0.008 * diagonal(wavy())
    keys = result.skinning.keyframes
    assert keys is not None
    moving = keys.sum(axis=0) > 1
    # a shot is played by itself: its ends are keys
    assert keys[[0, 5, 6, 14]][:, moving].all()


@pytest.mark.parametrize("bone_model", ["similarity", "affine"])
def test_other_bone_models(bone_model: Any) -> None:
    frames = wavy()
    result = ssdr.smallest(frames, tolerance="0.8%", bone_model=bone_model, effort="fast")
    assert result.skinning.bone_model == bone_model
    assert rmse_of(result.skinning, frames) <= 0.008 * diagonal(frames)


def test_frames_that_are_streamed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scan, "_IN_MEMORY", 1 << 10)
    monkeypatch.setattr(scan, "_FEWEST", 8)
    monkeypatch.setattr(scan, "_MOST", 9)
    assert scan.needs_streaming([ssdr.MeshSequence(wavy())])
    result = ssdr.smallest(wavy(), tolerance="0.8%", effort="fast")
    assert result.skinning.n_frames == 15
    assert rmse_of(result.skinning, wavy()) <= 0.008 * diagonal(wavy())
    assert result.skinning.n_bones <= small().skinning.n_bones + 1


def _stopped_in_a_pass(patch: pytest.MonkeyPatch, late: bool) -> tuple[Any, list[Any]]:
    """Result over streamed frames that the callback, or time, stops in the first pass; progress."""
    for name, value in (("_IN_MEMORY", 1), ("_FEWEST", 40), ("_MOST", 40)):
        patch.setattr(scan, name, value)
    seen: list[Any] = []

    def within() -> bool:
        return bool(seen) and seen[-1].phase == "all frames"

    def callback(progress: Any) -> bool:
        seen.append(progress)
        return within() and not late

    if late:
        patch.setattr(Monitor, "out_of_time", property(lambda _: within()))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        options = {"tolerance": "2%", "bones": 12, "effort": "balanced" if late else "fast"}
        return ssdr.smallest(motions.rippled(), **options, time_limit=1e6, callback=callback), seen


@pytest.mark.parametrize(("late", "reason"), [(False, "cancelled"), (True, "time limit")])
def test_callback_and_limit_are_asked_within_passes_over_all_frames(
    monkeypatch: pytest.MonkeyPatch, late: bool, reason: str
) -> None:
    result, seen = _stopped_in_a_pass(monkeypatch, late)
    assert result.stop_reason == reason
    # the pass is finished, and nothing follows it
    phases = [p.phase for p in seen]
    assert phases.count("all frames") == 1
    assert phases[-1] == "all frames"
    assert [p.fraction for p in seen] == sorted(p.fraction for p in seen)
    assert result.rmse == pytest.approx(rmse_of(result.skinning, motions.rippled()))


def test_history_under_a_tolerance_is_of_models_that_hold_it() -> None:
    """It may rise: a smaller model may have a larger error."""
    result = ssdr.smallest(wavy(), tolerance="1%")
    errors = [record.rmse for record in result.history]
    assert errors[-1] == result.rmse
    assert max(errors) <= result.parsimony.tolerance * (1 + 1e-9)


@pytest.mark.parametrize("tolerance", [1e4, 1e160, 1e308, "1e300%"])
@pytest.mark.parametrize("measure", ["rmse", "max"])
def test_a_tolerance_whose_square_is_no_number(tolerance: Any, measure: Any) -> None:
    """It ended in an OverflowError, or never."""
    result = ssdr.smallest(wavy(), tolerance=tolerance, measure=measure, effort="fast", rng=3)
    assert result.skinning.n_bones == 1
    assert result.stop_reason == "tolerance held"
    assert result.parsimony.tolerance > 1e3
