"""Triangles and balls, pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers import naive
from ssdr.kernels.raster import raster_balls, raster_triangles


def buffers(height, width):
    return np.full((height, width), -np.inf), np.full((height, width), -1, dtype=np.int32)


@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
def test_triangles_agree_with_a_naive_twin(seed, count):
    rng = np.random.default_rng(seed)
    height, width = 14, 18
    points = rng.uniform([-6, -6, 0.1], [24, 20, 2.0], size=(3 * count, 3))
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    depth, index = buffers(height, width)
    for first, last in ((0, 5), (5, 14)):
        raster_triangles(points, faces, depth, index, first, last)
    expected = naive.depth(points, faces, height, width)
    np.testing.assert_array_equal(np.isfinite(depth), np.isfinite(expected))
    covered = index >= 0
    np.testing.assert_array_equal(covered, np.isfinite(depth))
    np.testing.assert_allclose(depth[covered], expected[covered], rtol=1e-7, atol=1e-7)


def test_shared_edges_leave_no_holes_and_behind_the_camera_nothing_is_drawn():
    points = np.array([[1, 1, 1], [9, 1, 1], [9, 9, 1], [1, 9, 1], [5.0, 5, np.nan]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 1, 4], [0, 0, 1]], dtype=np.int32)
    depth, index = buffers(10, 10)
    raster_triangles(points, faces, depth, index, 0, 10)
    expected = np.zeros((10, 10), dtype=bool)
    expected[1:9, 1:9] = True
    np.testing.assert_array_equal(index >= 0, expected)
    assert index.max() <= 1


def test_balls_are_discs_whose_middle_is_nearest():
    depth, index = buffers(64, 64)
    balls = np.array([[32.5, 32.5, 20.0, 1.0, 0.25], [32.5, 32.5, 4.0, 0.5, 0.1]])
    raster_balls(balls, depth, index, 0, 64)
    assert depth[32, 32] == pytest.approx(1.25)
    assert (index == 0).sum() == pytest.approx(np.pi * 400, rel=0.02)
    assert (index == 1).sum() == 0
    rows, columns = np.nonzero(index == 0)
    assert np.hypot(rows - 32.0, columns - 32.0).max() <= 20.0
