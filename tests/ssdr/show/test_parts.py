"""Colours of vertices, measured vertices and films."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

import ssdr
from helpers.surfaces import sphere
from ssdr import show as render
from ssdr.show import Film
from ssdr.show.subject import Scene


@pytest.fixture(scope="module")
def pair():
    """Two balls side by side, the left one exact and the right one off by 0.1: truth, answer."""
    points, faces = sphere(2)
    n = len(points)
    side, step = np.array([1.2, 0, 0]), np.array([0.3, 0, 0])
    both = np.concatenate([points - side, points + side])
    truth = np.stack([both + k * step for k in range(3)]).astype(np.float32)
    answer = truth.copy()
    answer[:, n:, 1] += np.float32(0.1)
    both_faces = np.concatenate([faces, faces + n])
    made = [ssdr.MeshSequence(v, both_faces, 30.0, name="balls") for v in (truth, answer)]
    right = np.arange(2 * n) >= n
    return *made, {
        "colors": np.where(right[:, None], (0.8, 0.1, 0.1), render.SKIN),
        "measured": right,
    }


def halves(picture):
    """Colours well inside the two balls, sRGB 0 to 255."""
    pixels = np.asarray(picture, dtype=float)
    y, x = pixels.shape[0] // 2, pixels.shape[1]
    return pixels[y - 4 : y + 4, round(0.28 * x)].mean(0), pixels[
        y - 4 : y + 4, round(0.72 * x)
    ].mean(0)


LOOK = {"size": (160, 90), "azimuth": 0.0, "elevation": 0.0}


def test_figures_are_those_of_the_measured_vertices(pair):
    truth, answer, look = pair
    scene = Scene.of(answer, truth, **look)
    assert scene.distances.rmse == pytest.approx(0.1, rel=1e-5)
    assert Scene.of(answer, truth).distances.rmse == pytest.approx(0.1 / np.sqrt(2), rel=1e-5)
    assert scene.error_range([0]) == pytest.approx((0.1, 0.1), rel=1e-5)


def test_vertices_keep_their_colours(pair):
    _, answer, look = pair
    left, right = halves(render.render_frame(answer, 0, **look, **LOOK))
    assert right[0] > 1.8 * right[2]
    assert 1.05 * left[2] < left[0] < 1.8 * left[2]
    other = halves(render.render_frame(answer, 0, colors=look["colors"][::-1], **LOOK))
    assert other[0][0] > 1.8 * other[0][2]


def test_the_error_colours_the_measured_vertices_alone(pair):
    truth, answer, look = pair
    options = {"reference": truth, "style": "error", **look, **LOOK}
    low = halves(render.render_frame(answer, 0, scale=10.0, **options))
    high = halves(render.render_frame(answer, 0, scale=0.1, **options))
    # Grey, whatever the scale.
    np.testing.assert_array_equal(low[0], high[0])
    assert np.ptp(low[0]) < 25
    assert low[1].mean() > high[1].mean() + 60


def test_rows_columns_and_their_names(pair, monkeypatch):
    truth, answer, look = pair
    seen = []
    from ssdr.show import figures

    draw = figures.ImageDraw.ImageDraw
    write = draw.text
    monkeypatch.setattr(
        draw, "text", lambda s, xy, t, *a, **k: seen.append(t) or write(s, xy, t, *a, **k)
    )
    options = {"reference": truth, "frames": [0, 2], **look}
    names = {"row_names": ("truth", "prediction", "error"), "captions": ("first", "last")}
    render.contact_sheet(answer, width=600, unit=("mm", 1000.0), **names, **options)
    for text in ("truth", "prediction", "error", "first", "last", "balls"):
        assert text in seen
    assert seen.count("RMSE 100 mm") == 2
    assert any("RMSE 100 mm (" in t for t in seen)


@pytest.mark.parametrize("suffix", ["gif", "webp"])
def test_a_film_has_its_frames_and_its_panels_differ(pair, tmp_path, suffix):
    truth, answer, look = pair
    done = []
    options = {
        "reference": truth,
        "style": ["plain", "error"],
        "size": (96, 64),
        **look,
        "titles": ("truth", "prediction", "error"),
        "captions": ("a", "b", "c"),
        "unit": ("mm", 1000.0),
    }
    size = next(Film.of(answer, **options).pictures()).size
    path = Film.of(answer, **options).write(tmp_path / f"film.{suffix}", done.append)
    assert done == pytest.approx([1 / 3, 2 / 3, 1])
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    with Image.open(path) as read:
        assert (read.n_frames, read.size) == (3, size)
        assert size[0] % 2 == size[1] % 2 == 0
        shown = []
        for frame in (0, 2, 1):
            read.seek(frame)
            read.load()
            shown.append(read.info["duration"])
        # a GIF counts hundredths of a second, and all together take as long as they should
        assert sum(shown) == pytest.approx(3 * 1000 / 30, abs=1)
        assert max(shown) - min(shown) <= 10
        pixels = np.asarray(read.convert("RGB"), dtype=int)
    top = round(0.1 * 64)
    step = 96 + 2 * round(0.008 * 64)
    panels = [pixels[top : top + 64, k * step : k * step + 96] for k in range(3)]
    # The right ball is raised; in the error panel both have other colours.
    assert (np.abs(panels[0] - panels[1]).sum(2) > 60).mean() > 0.004
    assert (np.abs(panels[1] - panels[2]).sum(2) > 60).mean() > 0.1
    with pytest.raises(ssdr.InputError, match=r"film\.mp4"):
        Film.of(answer).write(tmp_path / "film.mp4")


def test_a_gif_keeps_many_colours(pair, tmp_path):
    truth, _, look = pair
    Film.of(truth, size=(120, 90), **look).write(tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as film:
        assert len(set(film.convert("RGB").get_flattened_data())) > 120
