"""The camera, depth and colours between vertices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssdr.render import raster


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(["x", "y", "z", "-x", "-y", "-z"]),
    st.booleans(),
    st.floats(-180, 180),
    st.floats(-89, 89),
    st.floats(0.4, 2.5),
)
def test_camera_sees_everything_and_wastes_nothing(seed, up, perspective, azimuth, elevation, wide):
    points = np.random.default_rng(seed).normal(size=(30, 3)) * [1, 3, 0.2] * 1e3 + 1e4
    camera = raster.Camera.fit(
        points, azimuth=azimuth, elevation=elevation, up=up, aspect=wide, perspective=perspective
    )
    np.testing.assert_allclose(camera.axes @ camera.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.axes) == pytest.approx(1.0)
    assert camera.axes[1] @ camera.vertical > 0
    size = (round(wide * 1000), 1000)
    screen = camera.project(points, size)
    assert np.isfinite(screen).all()
    share = screen[:, :2] / size
    assert share.min() >= 0.079
    assert share.max() <= 0.921
    spans = np.ptp(share, axis=0)
    assert spans.max() == pytest.approx(0.84, abs=0.02) or perspective


def test_depth_orders_what_the_camera_sees():
    camera = raster.Camera.fit(np.eye(3), azimuth=0, elevation=0)
    near, far = camera.project(np.array([[0.0, 0, 0.9], [0, 0, -0.9]]), (100, 100))[:, 2]
    assert near > far
    distance = camera.distance(np.array([near, far]))
    assert distance[1] - distance[0] == pytest.approx(1.8)


@pytest.mark.parametrize("perspective", [False, True])
def test_a_square_lands_on_its_pixels_with_its_color(perspective):
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    camera = raster.Camera.fit(square, azimuth=0, elevation=0, perspective=perspective, margin=0.25)
    red = np.tile([0.5, 0.0, 0.0], (4, 1))
    layer = raster.draw_mesh(camera, (80, 80), square, faces, red)
    expected = np.zeros((80, 80), dtype=bool)
    expected[20:60, 20:60] = True
    np.testing.assert_array_equal(layer.mask, expected)
    pixels = layer.color[layer.mask]
    np.testing.assert_allclose(pixels, np.broadcast_to(pixels[0], pixels.shape), atol=1e-9)
    # Green and blue hold nothing but the white highlight.
    assert pixels[0, 0] > 0.25
    assert pixels[0, 1] == pytest.approx(pixels[0, 2])
    assert pixels[0, 1] < 0.05


def test_colors_are_interpolated_in_space_not_on_the_screen():
    # A floor seen in perspective: the colour is the position along it.
    floor = np.array([[-1.0, 0, 0], [1, 0, 0], [1, 0, -8], [-1, 0, -8]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    camera = raster.Camera.fit(floor, azimuth=0, elevation=25)
    size = (120, 120)
    ramp = np.repeat((-floor[:, 2] / 8)[:, None], 3, axis=1)
    black = raster.draw_mesh(camera, size, floor, faces, np.zeros((4, 3))).color
    white = raster.draw_mesh(camera, size, floor, faces, np.ones((4, 3))).color
    layer = raster.draw_mesh(camera, size, floor, faces, ramp)
    rows, columns = np.nonzero(layer.mask)
    shade = (layer.color - black)[rows, columns, 0] / (white - black)[rows, columns, 0]
    pixel = size[1] / 2 / camera.scale
    ray = (
        ((columns + 0.5 - 60) / pixel)[:, None] * camera.axes[0]
        - ((rows + 0.5 - 60) / pixel)[:, None] * camera.axes[1]
        - camera.axes[2]
    )
    hit = camera.eye - ray * (camera.eye[1] / ray[:, 1])[:, None]
    np.testing.assert_allclose(shade, -hit[:, 2] / 8, atol=1e-9)
