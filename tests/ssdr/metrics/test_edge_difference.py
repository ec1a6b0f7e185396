"""STED, the spatio-temporal edge difference, against loops and invariances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from helpers import naive
from helpers.surfaces import animation, sphere
from ssdr import MeshSequence
from ssdr.metrics import rmse, sted

seeds = st.integers(0, 10**6)


@given(seed=seeds, F=st.integers(1, 9))
@settings(max_examples=25)
def test_sted_equals_naive_loops(seed, F):
    rng = np.random.default_rng(seed)
    vertices, faces = sphere(0)
    vertices = np.concatenate([vertices, [[9.0, 9, 9]]])  # with a loose vertex
    a = vertices + np.cumsum(0.2 * rng.normal(size=(F, 13, 3)), axis=0)
    b = a + 0.05 * rng.normal(size=a.shape)
    result = sted(a, b, faces)
    spatial, temporal = naive.sted(a, b, faces)
    assert result.spatial == pytest.approx(spatial, rel=1e-9, abs=1e-12)
    assert result.temporal == pytest.approx(temporal if F > 2 else 0.0, rel=1e-9, abs=1e-12)
    assert result.value == pytest.approx(math.sqrt(spatial**2 + result.temporal**2))
    assert result.spatial_per_frame.mean() == pytest.approx(result.spatial)


def test_the_speed_is_the_mean_step_or_the_diagonal_where_nothing_moves():
    a, faces = animation(F=6)
    b, _ = animation(1, F=6)
    speed = np.linalg.norm(np.diff(a, axis=0), axis=2).mean()
    assert sted(a, b, faces).speed == pytest.approx(speed)
    still = np.repeat(a[:1], 4, axis=0)
    assert sted(still, b[:4], faces).speed == pytest.approx(MeshSequence(still).diagonal())
    assert sted(np.zeros((3, 4, 3)), np.ones((3, 4, 3))).value == 0


def motions(count, seed, size=1.0):
    rng = np.random.default_rng(seed)
    return Rotation.random(count, rng=rng).as_matrix(), size * rng.normal(size=(count, 1, 3))


def test_sted_is_zero_for_equal_and_for_rigidly_moved():
    a, faces = animation(F=6)
    assert sted(a, a, faces).value == 0
    rotation, shift = motions(6, 0)
    apart = a @ rotation.transpose(0, 2, 1) + shift
    assert sted(a, apart, faces).spatial < 1e-14  # edge lengths do not move
    assert sted(a, apart, faces).temporal > 0.01
    once = a @ rotation[0].T + shift[0]
    assert sted(a, once, faces).value < 1e-13
    # A uniform scale changes all edges of a neighbourhood alike: no deviation.
    assert sted(a, 1.1 * a, faces).spatial < 1e-13


def test_sted_does_not_depend_on_the_scale():
    a, faces = animation(F=6)
    b = a + 0.02 * np.random.default_rng(2).normal(size=a.shape)
    base = sted(a, b, faces)
    for scale in (1e-5, 1e5):
        other = sted(scale * a, scale * b, faces)
        assert other.spatial == pytest.approx(base.spatial, rel=1e-9)
        assert other.temporal == pytest.approx(base.temporal, rel=1e-9)


def test_sted_tells_jitter_from_a_smooth_shift():
    # The same RMSE, in space and in time: noise is seen, a smooth displacement is not.
    vertices, faces = sphere(2)
    time = np.linspace(0, 1, 12)[:, None, None]
    a = vertices + time * [1.0, 0.5, 0]
    noise = 0.01 * np.random.default_rng(3).normal(size=a.shape)
    smooth = np.full_like(a, 0.01)
    assert rmse(a, a + noise) == pytest.approx(rmse(a, a + smooth), rel=0.05)
    noisy, smoothed = sted(a, a + noise, faces), sted(a, a + smooth, faces)
    assert noisy.spatial > 100 * smoothed.spatial
    assert noisy.temporal > 100 * smoothed.temporal


def test_sted_with_edges_of_no_length():
    a, faces = animation(F=4)
    a[:, faces[0, 1]] = a[:, faces[0, 0]]
    b = a + 0.01 * np.random.default_rng(4).normal(size=a.shape)
    result = sted(a, b, faces)
    assert np.isfinite(result.value)
    assert result.value > 0
