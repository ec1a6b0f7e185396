"""Pictures: the rasteriser against a naive twin, the camera, colours, figures and films."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import ssdr
from ssdr import render
from ssdr.kernels.raster import raster_balls, raster_triangles
from ssdr.render import palette, raster


def buffers(height, width):
    return np.full((height, width), -np.inf), np.full((height, width), -1, dtype=np.int32)


def naive_depth(points, faces, height, width):
    """Nearness at each pixel's centre from the plane through the triangle, pixel by pixel."""
    out = np.full((height, width), -np.inf)
    for face in faces:
        corners = points[face]
        system = np.column_stack([corners[:, :2], np.ones(3)])
        if abs(np.linalg.det(system)) < 1e-12:
            continue
        plane = np.linalg.solve(system, corners[:, 2])
        for row in range(height):
            for column in range(width):
                x, y = column + 0.5, row + 0.5
                sides = []
                for k in range(3):
                    (x0, y0), (x1, y1) = corners[k, :2], corners[(k + 1) % 3, :2]
                    sides.append((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0))
                if all(s >= 0 for s in sides) or all(s <= 0 for s in sides):
                    out[row, column] = max(out[row, column], plane @ [x, y, 1.0])
    return out


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
def test_triangles_agree_with_a_naive_twin(seed, count):
    rng = np.random.default_rng(seed)
    height, width = 14, 18
    points = rng.uniform([-6, -6, 0.1], [24, 20, 2.0], size=(3 * count, 3))
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    depth, index = buffers(height, width)
    for first, last in ((0, 5), (5, 14)):
        raster_triangles(points, faces, depth, index, first, last)
    expected = naive_depth(points, faces, height, width)
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


def test_srgb_round_trip_and_heat_darkens_steadily():
    x = np.linspace(0, 1, 257)
    np.testing.assert_allclose(palette.linear_from_srgb(palette.srgb_from_linear(x)), x, atol=1e-12)
    light = palette.heat(x) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(light) < 0).all()
    np.testing.assert_array_equal(palette.heat([-1.0, 7.0]), palette.heat([0.0, 1.0]))


def test_neighbouring_bones_get_colors_far_apart(rng):
    x = rng.uniform(size=(60, 3))
    colors = palette.bone_colors(x)
    np.testing.assert_array_equal(colors, palette.bone_colors(x))
    assert colors.min() >= 0
    assert colors.max() <= 1
    srgb = palette.srgb_from_linear(colors)
    gap = np.linalg.norm(x[:, None] - x[None], axis=2) + 9 * np.eye(60)
    nearest = np.linalg.norm(srgb - srgb[gap.argmin(axis=1)], axis=1)
    assert nearest.min() > 0.25
    for n in (1, 2, 300):
        assert palette.bone_colors(np.zeros((n, 3))).shape == (n, 3)


def test_a_vertex_of_one_bone_has_the_color_of_the_bone(rng):
    colors = palette.bone_colors(rng.normal(size=(7, 3)))
    joints = np.stack([np.arange(7), np.zeros(7, dtype=int)], axis=1)
    mixed = palette.mix(colors, np.tile([1.0, 0.0], (7, 1)), joints)
    np.testing.assert_allclose(mixed, colors, atol=1e-6)


@pytest.fixture
def model(wave):
    """Two bones over the waving grid: near it, not on it."""
    x = wave.vertices[0, :, 0].astype(np.float64) / 2
    transforms = np.zeros((wave.n_frames, 2, 3, 4))
    transforms[..., :3] = np.eye(3)
    transforms[:, 1, 2, 3] = 0.2 * np.arange(wave.n_frames)
    return ssdr.Skinning(
        wave.vertices[0],
        np.tile([0, 1], (len(x), 1)),
        np.stack([1 - x, x], axis=1),
        transforms,
        faces=wave.faces,
        fps=wave.fps,
    )


def is_drawn(picture):
    return np.asarray(picture.convert("L")).std() > 3


@pytest.mark.parametrize("style", ["plain", "weights", "bones", "error"])
def test_every_style_draws_something_of_its_own(model, wave, style):
    picture = render.render_frame(model, 1, style=style, reference=wave, size=(120, 90))
    assert picture.size == (120, 90)
    assert picture.mode == "RGB"
    assert is_drawn(picture)
    other = render.render_frame(
        model, 1, style="plain" if style != "plain" else "weights", size=(120, 90)
    )
    assert np.abs(np.asarray(picture, dtype=int) - np.asarray(other, dtype=int)).max() > 30


def test_same_bits_whatever_the_number_of_threads(model):
    pictures = []
    try:
        for threads in (1, 3):
            ssdr.set_threads(threads)
            pictures.append(np.asarray(render.render_frame(model, 2, size=(200, 200))))
    finally:
        ssdr.set_threads(None)
    np.testing.assert_array_equal(*pictures)


def test_error_saturates_at_the_scale(wave):
    moved = dataclasses.replace(wave, vertices=wave.vertices + np.float32(0.5))
    kwargs = {"reference": wave, "style": "error", "size": (100, 100), "azimuth": 0.0}
    low = np.asarray(render.render_frame(moved, 0, scale=1e3, **kwargs), dtype=int)
    high = np.asarray(render.render_frame(moved, 0, scale=0.1, **kwargs), dtype=int)
    covered = np.abs(high - low).sum(axis=2) > 200
    assert covered.mean() > 0.05
    assert low[covered].mean() > high[covered].mean() + 60


def test_contact_sheet_has_its_rows_and_columns(model, wave, tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    full = render.contact_sheet(model, reference=wave, frames=3, width=600)
    short = render.contact_sheet(model, frames=[0, -1], width=600)
    assert full.width == short.width == 600
    assert full.height > short.height
    render.write_picture(full, tmp_path / "sheet.png")
    with Image.open(tmp_path / "sheet.png") as back:
        back.load()
        assert back.format == "PNG"
        assert is_drawn(back)
        np.testing.assert_array_equal(np.asarray(back), np.asarray(full))
    assert [p.name for p in tmp_path.iterdir()] == ["sheet.png"]


def test_subjects_of_every_kind(model, wave, seam):
    cloud = ssdr.MeshSequence(wave.vertices, fps=wave.fps)
    assert is_drawn(render.contact_sheet(cloud, frames=2, width=400))
    single = ssdr.MeshSequence(np.zeros((1, 1, 3)))
    assert is_drawn(render.render_frame(single, size=(64, 64)))

    class Result:
        skinning = model

    assert is_drawn(render.render_frame(Result(), size=(64, 64)))
    welded, _ = seam.weld()
    other = dataclasses.replace(welded, vertices=welded.vertices * np.float32(1.01))
    picture = render.contact_sheet(other, reference=seam, frames=2, width=400)
    assert is_drawn(picture)


def test_far_travel_is_followed(wave):
    steps = np.float32(100) * np.arange(4, dtype=np.float32)[:, None, None] * np.float32([1, 0, 0])
    walking = dataclasses.replace(wave, vertices=wave.vertices + steps)
    still = np.asarray(render.render_frame(wave, 3, size=(100, 100), azimuth=20.0), dtype=int)
    moved = np.asarray(render.render_frame(walking, 3, size=(100, 100), azimuth=20.0), dtype=int)
    assert is_drawn(Image.fromarray(moved.astype(np.uint8)))
    assert (np.abs(still - moved).sum(axis=2) > 60).mean() < 0.2


def test_film_is_complete_and_written_at_once(model, wave, tmp_path):
    done = []
    path = render.animate(
        model,
        tmp_path / "film.gif",
        style=["weights", "bones"],
        reference=wave,
        size=(64, 48),
        callback=done.append,
    )
    with Image.open(path) as film:
        assert film.n_frames == wave.n_frames
        assert film.size == (3 * 64, 48)
        assert film.info["duration"] == 40
    assert done[-1] == 1.0
    with pytest.raises(ssdr.FormatError, match=r"film\.mp4"):
        render.animate(model, tmp_path / "film.mp4")
    assert [p.name for p in tmp_path.iterdir()] == ["film.gif"]


def test_a_picture_that_fails_leaves_the_old_one(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(b"old")

    class Broken(Image.Image):
        def save(self, *args, **kwargs):
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        render.write_picture(Broken(), path)
    assert path.read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1
    with pytest.raises(ssdr.FormatError, match="not the name of a picture"):
        render.write_picture(Image.new("RGB", (4, 4)), tmp_path / "a.xyz")


@pytest.mark.parametrize(
    ("argument", "options"),
    [
        ("frames", {"frame": 9}),
        ("style", {"style": "glossy"}),
        ("reference", {"style": "error"}),
        ("size", {"size": (1, 100)}),
        ("supersample", {"supersample": 9}),
        ("up", {"up": "w"}),
        ("up", {"up": "--y"}),
        ("elevation", {"elevation": 100.0}),
        ("azimuth", {"azimuth": float("nan")}),
    ],
)
def test_bad_options_are_named(model, argument, options):
    with pytest.raises(ssdr.InputError) as caught:
        render.render_frame(model, **options)
    assert caught.value.argument == argument


def test_subject_and_reference_must_match(model, wave):
    with pytest.raises(ssdr.InputError, match="reference"):
        render.render_frame(model, reference=ssdr.MeshSequence(wave.vertices[:2], wave.faces))
    with pytest.raises(ssdr.InputError, match="subject"):
        render.render_frame(np.zeros((2, 3, 3)))
    with pytest.raises(ssdr.InputError, match="bones"):
        render.render_frame(wave, style="bones")
    with pytest.raises(ssdr.InputError, match="frames"):
        render.contact_sheet(wave, frames=[])
    with pytest.raises(ssdr.InputError, match="width"):
        render.contact_sheet(wave, width=10)
