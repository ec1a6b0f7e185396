"""``decompose(..., start=...)``: a model to go on from, and parts of one."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions, stretches, trees
from helpers.measures import check, diagonal, frames, played, rig, rmse_of
from ssdr.search import scan

Solve = Callable[..., ssdr.Decomposition]

# a model to go on from


@functools.cache
def skeleton() -> ssdr.Skinning:
    return trees.six_bones().skinning(bone_names=tuple("abcdef"))


def hasty(solve: Solve) -> ssdr.Skinning:
    """The model of a call that is stopped at the first polish that makes one."""
    polished = {"callback": lambda p: p.phase == "polish" and np.isfinite(p.rmse)}
    return solve(effort="balanced", **polished).skinning


def moving(kind: str) -> np.ndarray:
    if kind in ("rigid rig", "skeleton"):
        return trees.six_bones().wavy
    if kind in stretches.KINDS:
        return motions.wobble(stretches.rig(kind), 0.05)
    return motions.rippled() if kind == "streamed" else frames()


def test_a_result_stands_for_its_model() -> None:
    array = frames()
    result = ssdr.decompose(array, bones=3, effort="fast", rig="rigid")
    again, same = (
        ssdr.decompose(array, start=start, effort="fast", rig=ssdr.Skeleton(tree))
        for start, tree in ((result, result), (result.skinning, result.skinning))
    )
    np.testing.assert_array_equal(again.skinning.transforms, same.skinning.transforms)
    np.testing.assert_array_equal(again.skinning.weights, same.skinning.weights)
    found = [
        ssdr.smallest(array, tolerance="5%", start=start, effort="fast")
        for start in (result, result.skinning)
    ]
    assert found[0].rmse == found[1].rmse


KINDS: dict[str, dict[str, Any]] = {
    "free": {"bones": 5},
    "two influences": {"bones": 5, "influences": 2},
    "loose": {"bones": 5, "rig": "loose"},
    "rigid rig": {"bones": 6, "influences": 2, "rig": "rigid"},
    "skeleton": {"influences": 2, "rig": ssdr.Skeleton(skeleton(), extra_bones=1)},
    "similarity": {"bones": 4, "bone_model": "similarity"},
    "affine": {"bones": 4, "bone_model": "affine"},
    "streamed": {"bones": 4},
    "smooth": {"bones": 5, "smoothness": 0.05, "faces": rig().faces},
}


@pytest.mark.parametrize("effort", ["fast", pytest.param("balanced", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_a_model_is_never_left_for_a_worse_one(
    kind: str, effort: str, tiny_memory: Callable[[], None]
) -> None:
    """Neither an unfinished nor a finished start is followed by a higher error."""
    if kind == "streamed":
        tiny_memory()
    array = moving(kind)
    solve = functools.partial(ssdr.decompose, array, **KINDS[kind])
    early = hasty(solve)
    for start in (early, solve(effort=effort).skinning):
        result = solve(effort=effort, start=start)
        model = result.skinning
        check(result, array, start.n_bones, KINDS[kind].get("influences", 4))
        if kind != "smooth":  # where error and penalty together may not rise
            assert result.rmse <= rmse_of(start, array) * (1 + 1e-12)
        if start is early:
            assert result.rmse < rmse_of(start, array)
        assert model.bone_model == start.bone_model
        assert (model.parents is None) == (start.parents is None)
        if kind in ("rigid rig", "skeleton"):
            assert model.joint_gaps().max() < 1e-9 * diagonal(array)
        if kind == "skeleton":
            assert np.array_equal(model.parents, start.parents)
            assert model.names()[:6] == skeleton().names()


@pytest.fixture
def tiny_memory(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """From the call on, frames count as too large to be held at once."""

    def shrink() -> None:
        for name, value in (("_IN_MEMORY", 1), ("_FEWEST", 40), ("_MOST", 40)):
            monkeypatch.setattr(scan, name, value)

    return shrink


@pytest.mark.parametrize(
    "options",
    [{}, {"bone_model": "affine"}, {"rig": "loose"}, {"influences": 7}, {"bones": 5}],
    ids=str,
)
def test_the_best_there_is_comes_back_in_the_form_that_was_asked_for(
    options: dict[str, Any],
) -> None:
    exact = rig()
    named = dataclasses.replace(exact.skinning, bone_names=tuple("vwxyz"), name="old", fps=60)
    sequence = ssdr.MeshSequence(exact.frames, exact.faces, 30, name="new")
    result = ssdr.decompose(sequence, start=named, effort="fast", **options)
    model = check(result, exact.frames, 5, options.get("influences", 4)).skinning
    assert result.rmse < 1e-15 * diagonal(exact.frames)
    np.testing.assert_array_equal(model.rest, exact.rest)
    np.testing.assert_allclose(model.transforms, exact.transforms, rtol=0, atol=1e-13)
    assert model.bone_model == options.get("bone_model", "rigid")
    assert (model.parents is not None) == ("rig" in options)
    assert model.clips == (ssdr.Clip("new", 0, 15, 30.0),)


@pytest.mark.parametrize("same_length", [True, False])
@pytest.mark.parametrize("hung", [False, True])
@pytest.mark.parametrize("streamed", [False, True])
def test_bones_of_a_model_of_other_frames_are_fitted_to_its_weights(
    same_length: bool, hung: bool, streamed: bool, tiny_memory: Callable[[], None]
) -> None:
    """This also holds where both have equally many frames and the transforms are far off."""
    if streamed:
        tiny_memory()
    # one skeleton in two motions: random turns are the same whatever the length
    few = np.arange(0, 120, 1 if same_length else 2)
    other = made_of_other_motion()
    array = trees.skeleton(6, 120, seed=3).frames
    start = other.skinning(transforms=other.transforms[few])
    fitted = ssdr.fit_bones(array, start)
    start = start if hung else dataclasses.replace(start, parents=None, joint_positions=None)
    options = {"influences": 2, "effort": "fast", "rig": "rigid" if hung else None}
    result = ssdr.decompose(array, start=start, **options)
    check(result, array, 6, 2)
    size = diagonal(array)
    assert rmse_of(dataclasses.replace(start, transforms=other.transforms), array) > 0.05 * size
    assert result.rmse <= fitted.rmse + 1e-9 * size
    if hung:
        assert np.array_equal(result.skinning.parents, start.parents)
        assert result.skinning.joint_gaps().max() < 1e-9 * size


@functools.cache
def made_of_other_motion() -> trees.Skeleton:
    slow = trees.skeleton(6, 120, seed=3)
    return dataclasses.replace(slow, transforms=slow.transforms[::-1])


def test_where_importances_count_the_weighted_error_does_not_rise() -> None:
    heavy = np.where(np.arange(84) < 42, 20.0, 1.0)
    options = {"bones": 3, "vertex_importance": heavy, "effort": "fast"}

    def weighted(model: ssdr.Skinning) -> float:
        return float((((played(model) - frames()) ** 2).sum(axis=2) @ heavy).sum())

    first = ssdr.decompose(frames(), **options).skinning
    again = ssdr.decompose(frames(), start=first, **options).skinning
    assert weighted(again) <= weighted(first)


def test_a_rig_from_a_file_of_single_precision_is_taken_up(tmp_path: Path) -> None:
    """In such a file joints come apart by rounding."""
    array = moving("rigid rig")
    options = {"influences": 2, "rig": "rigid", "effort": "fast"}
    first = ssdr.decompose(array, bones=6, **options).skinning
    ssdr.save(first, tmp_path / "rig.glb")
    start = ssdr.load_skinning(tmp_path / "rig.glb")
    assert start.joint_gaps().max() > 0
    result = ssdr.decompose(array, start=start, **options)
    assert result.rmse <= rmse_of(start, array) * (1 + 1e-6)
    assert np.array_equal(result.skinning.parents, start.parents)
    assert result.skinning.joint_gaps().max() < 1e-9 * diagonal(array)


def test_the_start_is_left_alone() -> None:
    start = ssdr.decompose(frames(), bones=4, effort="fast").skinning
    names = ("rest", "indices", "weights", "transforms")
    before = [getattr(start, name).copy() for name in names]
    ssdr.decompose(frames(), start=start, effort="fast")
    for name, array in zip(names, before, strict=True):
        assert np.array_equal(getattr(start, name), array), name
