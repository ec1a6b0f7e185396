"""The page plays shapes, and its sliders drive expressions."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.browser import Browser, chromium
from helpers.rig_model import tube


def face():
    """A tube with two expressions, each a clip of two frames, the first at rest."""
    model = tube(frames=4)
    moves = model.transforms.copy()
    moves[::2] = np.eye(3, 4)
    amounts = np.array([[0, 0], [1, 0], [0, 0], [0, 1.0]])
    moved = np.random.default_rng(0).normal(0, 0.1, (2, model.n_vertices, 3))
    moved[0, 30:] = 0
    clips = ssdr.Clip("smile", 0, 2, 24), ssdr.Clip("frown", 2, 4, 24)
    shapes = ssdr.Shapes(moved, amounts)
    bones = dataclasses.replace(model, transforms=moves, clips=clips, fps=None)
    return ssdr.ShapedSkinning(bones, shapes, driven=True)


@pytest.mark.skipif(chromium() is None, reason="Chromium or Chrome was not found")
def test_the_page_plays_shapes_and_drives_expressions(tmp_path):
    model = face()
    ssdr.view(model, None, tmp_path / "a.html", open=False)
    with Browser(tmp_path / "profile") as browser:
        browser.open(tmp_path / "a.html")
        browser.value("ssdr.ready")
        for frame in (1, 3):
            found = browser.value(f"Array.from(ssdr.vertices({frame}))")
            shown = np.reshape(found, (-1, 3))
            np.testing.assert_allclose(shown, model.skin([frame])[0], atol=1e-4)
        sliders = "document.querySelectorAll('#expression-sliders input')"
        assert browser.value(f"{sliders}.length") == 2
        browser.value(f"(() => {{ const s = {sliders}; s[0].value = 50; s[1].value = 100; "
                      "s[1].dispatchEvent(new Event('input')); })()")  # fmt: skip
        frame = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
        browser.value(frame)
        shown = np.reshape(browser.value("Array.from(ssdr.read(0))"), (-1, 3))[: model.n_vertices]
        expected = ssdr.drive(model, [[0.5, 1.0]]).skin()[0]
        np.testing.assert_allclose(shown, expected, atol=1e-4)
        browser.value("ssdr.seek(1)")  # a frame takes the weights back
        assert browser.value(f"{sliders}[1].value") == "0"
        assert not browser.complaints()
