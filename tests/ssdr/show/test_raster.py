"""The camera, depth and colours between vertices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssdr.show import camera as raster


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(["x", "y", "z", "-x", "-y", "-z"]),
    st.floats(-180, 180),
    st.floats(-89, 89),
    st.floats(0.4, 2.5),
)
def test_camera_sees_everything_and_wastes_nothing(seed, up, azimuth, elevation, wide):
    points = np.random.default_rng(seed).normal(size=(30, 3)) * [1, 3, 0.2] * 1e3 + 1e4
    camera = raster.Camera.fit(points, azimuth=azimuth, elevation=elevation, up=up, aspect=wide)
    np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.axes) == pytest.approx(1.0)
    assert camera.axes[1] @ camera.vertical > 0
    size = (round(wide * 1000), 1000)
    screen = camera.project(points, size)
    assert np.isfinite(screen).all()
    share = screen[:, :2] / size
    assert share.min() >= 0.079
    assert share.max() <= 0.921
    view = (points - camera.eye) @ camera.axes.T
    clearance = -view[:, 2].max() / np.linalg.norm(np.ptp(view, axis=0))
    if clearance > 0.0501:  # the sides of the picture decide how close the eye is, not its nearness
        assert max(share.max(axis=0) - 0.5) == pytest.approx(0.42, abs=0.01)
    else:
        assert clearance == pytest.approx(0.05)


def test_depth_orders_what_the_camera_sees():
    camera = raster.Camera.fit(np.eye(3), azimuth=0, elevation=0)
    near, far = camera.project(np.array([[0.0, 0, 0.9], [0, 0, -0.9]]), (100, 100))[:, 2]
    assert near > far
    assert 1 / far - 1 / near == pytest.approx(1.8)


def test_a_square_lands_on_its_pixels():
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    camera = raster.Camera.fit(square * 1.68, azimuth=0, elevation=0)
    nearness = raster.empty_depth((80, 80))
    pixels, hit, _ = raster.triangles_seen(camera, square, faces, nearness)
    expected = np.zeros((80, 80), dtype=bool)
    expected[20:60, 20:60] = True
    np.testing.assert_array_equal(np.isfinite(nearness), expected)
    np.testing.assert_array_equal(np.stack(pixels), np.stack(np.nonzero(expected)))
    assert np.bincount(hit).min() > 750


def test_a_ball_is_round_and_its_normals_point_outwards():
    camera = raster.Camera.fit(np.eye(3), azimuth=30)
    size, center, radius = (200, 160), np.array([[0.3, 0.2, 0.1]]), 0.25
    nearness = raster.empty_depth(size)
    pixels, _, normal = raster.balls_seen(camera, center, radius, nearness)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-12)
    seen = camera.project(center + radius * normal, size)
    across = np.hypot(seen[:, 0] - pixels[1] - 0.5, seen[:, 1] - pixels[0] - 0.5)
    assert np.quantile(across, 0.9) < 3
    nearest = seen[:, 2].argmax()
    assert nearness[pixels][nearest] == pytest.approx(seen[nearest, 2], rel=1e-3)


def test_values_are_interpolated_in_space_not_on_the_screen():
    # A floor seen in perspective: the value is the position along it.
    floor = np.array([[-1.0, 0, 0], [1, 0, 0], [1, 0, -8], [-1, 0, -8]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    camera = raster.Camera.fit(floor, azimuth=0, elevation=25)
    size = (120, 120)
    pixels, hit, share = raster.triangles_seen(camera, floor, faces, raster.empty_depth(size))
    at = raster.between(share, floor[faces[hit]])
    pixel = raster.pixels_per_unit(size)
    right, up = (pixels[1] + 0.5 - 60) / pixel, (60 - pixels[0] - 0.5) / pixel
    ray = np.stack([right, up, -np.ones(len(up))], axis=1) @ camera.axes
    expected = camera.eye - ray * (camera.eye[1] / ray[:, 1])[:, None]
    np.testing.assert_allclose(at, expected, atol=1e-9)
