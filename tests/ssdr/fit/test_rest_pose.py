"""The rest pose against one dense least-squares problem a vertex."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ssdr
from helpers import motions, naive
from helpers.stretches import KINDS, rig


@settings(max_examples=20)
@given(
    seed=st.integers(0, 10**6),
    influences=st.integers(1, 4),
    offset=st.sampled_from([0.0, 1e3]),
)
def test_against_dense_least_squares(seed: int, influences: int, offset: float) -> None:
    rng = np.random.default_rng(seed)
    transforms = motions.motions(rng, 5, 4)
    indices, weights = motions.weights_of(rng, 6, 4, influences)
    frames = offset + rng.standard_normal((5, 6, 3))
    fit = ssdr.fit_rest_pose(frames, motions.model(frames[0], indices, weights, transforms))
    want = naive.rest_position(frames, indices, weights, transforms)
    np.testing.assert_allclose(fit.skinning.rest, want, atol=1e-8 * max(1.0, offset))
    error = naive.squared_error(frames, want, indices, weights, transforms)
    np.testing.assert_allclose(fit.squared_error, error, rtol=1e-6)
    assert fit.rmse == pytest.approx(np.sqrt(error.sum() / 30), rel=1e-6)


def test_what_the_motion_leaves_open_stays() -> None:
    """Half of a quarter turn and half of its inverse: only the axis is determined."""
    transforms = np.zeros((3, 2, 3, 4))
    transforms[:, 0, :, :3] = motions.rotation(np.pi / 2, 0, 0)
    transforms[:, 1, :, :3] = motions.rotation(-np.pi / 2, 0, 0)
    indices = np.array([[0, 1], [0, 0]], dtype=np.int32)
    weights = np.array([[0.5, 0.5], [1.0, 0.0]])
    start = np.array([[9.0, 0.25, -0.5], [0.0, 0.0, 0.0]])
    frames = np.tile(np.array([[2.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), (3, 1, 1))
    fit = ssdr.fit_rest_pose(frames, motions.model(start, indices, weights, transforms))
    np.testing.assert_allclose(fit.skinning.rest[0], [2.0, 0.25, -0.5], atol=1e-2)
    np.testing.assert_allclose(fit.skinning.rest[1], [0.0, 0.0, -1.0], atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_the_rest_pose_of_bones_that_stretch(kind: str) -> None:
    truth = rig(kind)
    model = dataclasses.replace(truth.skinning, rest=truth.rest + 0.1, bone_model=kind)
    fit = ssdr.fit_rest_pose(truth.frames, model)
    np.testing.assert_allclose(fit.skinning.rest, truth.rest, atol=1e-6)
