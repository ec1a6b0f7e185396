"""``decompose(..., rig=ssdr.Skeleton(...))``: a hierarchy that is handed over and kept."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

import ssdr
from helpers import trees
from helpers.measures import check, diagonal, rmse_of

NAMES = ("hips", "spine", "arm", "leg", "hand", "foot")


@functools.cache
def _rig() -> ssdr.Skinning:
    return trees.six_bones().skinning(bone_names=NAMES)


def _solve(frames=None, *, skeleton=None, effort="fast", start=None, **rig) -> ssdr.Decomposition:
    frames = trees.six_bones().frames if frames is None else frames
    rig = ssdr.Skeleton(_rig() if skeleton is None else skeleton, **rig)
    return ssdr.decompose(frames, influences=2, effort=effort, start=start, rig=rig)


def _check(result: ssdr.Decomposition, bones: int = 6) -> ssdr.Skinning:
    model = result.skinning
    check(result, trees.six_bones().frames, bones, 2)
    assert np.array_equal(model.parents[:6], trees.six_bones().parents)
    assert model.names()[:6] == NAMES
    assert model.joint_gaps().max() < 1e-6 * diagonal(trees.six_bones().frames)
    return model


def test_motion_alone() -> None:
    made = trees.six_bones()
    kept = ssdr.Kept(indices=made.indices, weights=made.weights, rest=made.rest)
    result = _solve(start=kept)
    model = _check(result)
    assert result.rmse < 1e-6 * diagonal(made.frames)
    np.testing.assert_allclose(model.rest, made.rest, atol=1e-12)
    np.testing.assert_allclose(model.dense_weights(), _rig().dense_weights(), atol=1e-12)
    np.testing.assert_allclose(model.transforms, made.transforms, atol=1e-4)
    hung = made.parents >= 0
    np.testing.assert_allclose(model.joint_positions[hung], made.points[hung], atol=1e-12)


@pytest.mark.parametrize("effort", ["fast", "balanced"])
def test_loose_joints_keep_the_parents_and_may_come_apart(effort) -> None:
    made = trees.six_bones()
    pulled = made.frames.copy()
    far = made.weights[:, 0] * (made.indices[:, 0] == 5)
    away = np.sin(np.linspace(0, 6, len(pulled)))[:, None, None] * [0.0, 0.3, 0.0]
    pulled += far[None, :, None] * away
    result = _solve(pulled, joints="loose", effort=effort)
    model = result.skinning
    assert np.array_equal(model.parents, made.parents)
    assert model.names() == NAMES
    rigid = _solve(pulled, effort=effort)
    assert result.rmse < (0.8 if effort == "fast" else 0.5) * rigid.rmse
    assert model.joint_gaps()[:, 5].max() > 0.05
    assert result.rmse == pytest.approx(rmse_of(model, pulled), rel=1e-6)


def test_extra_bones_lower_the_error_each_time() -> None:
    errors = []
    for extra in (0, 2, 4, 8):
        result = _solve(trees.six_bones().wavy, extra_bones=extra)
        model = result.skinning
        assert model.n_bones == 6 + extra
        assert np.array_equal(model.parents[:6], trees.six_bones().parents)
        assert (model.parents[6:] >= 0).all()
        assert model.names()[:6] == NAMES
        assert len(set(model.names())) == 6 + extra
        errors.append(result.rmse)
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.75 * errors[0]


def test_extra_bones_below_named_ones() -> None:
    result = _solve(trees.six_bones().wavy, extra_bones={"hand": 2, "spine": 1})
    model = result.skinning
    assert model.parents[6:].tolist() == [NAMES.index("hand")] * 2 + [NAMES.index("spine")]
    assert (model.dense_weights()[:, 6:].max(axis=0) > 0).all()
    assert result.rmse < _solve(trees.six_bones().wavy).rmse


def test_a_rig_of_another_mesh_gives_joints_and_parents() -> None:
    made = trees.six_bones()
    frames = np.concatenate([made.rest[None], made.frames])
    other = dataclasses.replace(
        _rig(), rest=made.rest[::2], indices=made.indices[::2], weights=made.weights[::2]
    )
    result = _solve(frames, skeleton=other, effort="balanced")
    assert np.array_equal(result.skinning.parents, made.parents)
    assert result.rmse < 1e-6 * diagonal(frames)


MADE = trees.six_bones()
SCALED = np.broadcast_to(np.eye(3, 4), (1, 6, 3, 4)).copy()
SCALED[0, 3, :, :3] = np.diag([1.0, 2.0, 0.5])
ODD = {
    "a bone of no length": {
        "joint_positions": np.where(
            np.arange(6)[:, None] == 4, MADE.points[MADE.parents[4]], MADE.points
        )
    },
    "two roots": {"parents": np.where(np.arange(6) == 1, -1, MADE.parents)},
    "scaled unevenly": {"transforms": SCALED},  # lends its joints, not its scales
    "names that repeat": {"bone_names": ("a",) * 6},
}


@pytest.mark.parametrize("name", ODD)
def test_odd_skeletons_are_kept(name: str) -> None:
    given = dataclasses.replace(_rig(), **ODD[name])
    result = _solve(skeleton=given)
    model = check(result, MADE.frames, 6, 2).skinning
    assert np.array_equal(model.parents, given.parents)
    assert (model.names(), model.bone_model) == (given.names(), "rigid")
    assert model.joint_gaps().max() < 1e-6 * diagonal(MADE.frames)
    bound = {"two roots": 1e-4, "scaled unevenly": 1e-5}.get(name, np.inf)
    assert result.rmse < bound * diagonal(MADE.frames)
