"""Sheets of truth, prediction and error."""

import dataclasses

import numpy as np
import pytest
from PIL import Image

from garmentnet.drawing.dressed import draw_clip
from ssdr.show import figures


def off_by_30_mm(clip):
    return np.asarray(clip.sequence.vertices[:]) + np.float32([0, 0.03, 0])


@pytest.fixture
def texts(monkeypatch):
    """Texts of the sheet that is drawn."""

    seen = []
    write = figures.ImageDraw.ImageDraw.text

    def note(self, xy, text, *args, **kwargs):
        seen.append(text)
        write(self, xy, text, *args, **kwargs)

    monkeypatch.setattr(figures.ImageDraw.ImageDraw, "text", note)
    return seen


def test_rows_are_named_and_the_exact_body_does_not_count(toy_store, texts, tmp_path):
    outfit = dataclasses.replace(toy_store, pinned=np.arange(toy_store.n_vertices) < 16)
    clip = dataclasses.replace(toy_store.clip("base-test-0"), outfit=outfit)
    path = draw_clip(clip, off_by_30_mm(clip), tmp_path / "a.png")
    with Image.open(path) as sheet:
        assert sheet.mode == "RGB"
        assert len(sheet.getcolors(1 << 24)) > 4096
    assert [t for t in texts if t in ("truth", "prediction", "error")] == [
        *("truth", "prediction", "error")
    ]
    assert any(t.endswith("RMSE: all 30.0 mm, free 30.0 mm") for t in texts)
    assert texts.count("RMSE 30 mm") == 5
    assert "stand  ·  0.30 s" in texts
