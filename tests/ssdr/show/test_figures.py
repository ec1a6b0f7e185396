"""Pictures, contact sheets and films."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from PIL import Image

import ssdr
from ssdr import show as render


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
    with pytest.raises(ssdr.InputError, match="path: expected a picture"):
        render.write_picture(full, tmp_path / "a.xyz")


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
