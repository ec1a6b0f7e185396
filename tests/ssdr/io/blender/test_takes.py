"""Takes of FBX files: their frames and rates, and what the command makes of them."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

import ssdr
from helpers.blender_scene import as_blender_shows, export, needs_blender
from helpers.rig_model import largest_distance, tube

pytestmark = [pytest.mark.slow, needs_blender]


@pytest.mark.parametrize("fps", [0.4, 7.3, 12.5, 24000 / 1001, 29.97, 240.0])
def test_any_frame_rate_of_our_own(tmp_path, fps):
    model = dataclasses.replace(tube(frames=9), clips=None, fps=fps)
    report = ssdr.save(model, tmp_path / "a.fbx")
    assert report.max_error < 1e-6 * 6
    back = ssdr.load_skinning(tmp_path / "a.fbx")
    assert (back.fps, back.n_frames) == (fps, 9)
    assert largest_distance(back.skin(), model.skin()) < 1e-6 * 6


TWO_TAKES = """
r = rig(bones=3)
strip("a", r)
r.animation_data_create()
for name, bones, end in (("first", (0, 1, 2), 8), ("second", (1,), 5)):
    turn(r, name, bones, frames=(0, end))
    action = r.animation_data.action
    r.animation_data.action = None
    track = r.animation_data.nla_tracks.new()
    track.name = name
    track.strips.new(name, 0, action).name = name
"""
NLA = "bake_anim_use_nla_strips=True, bake_anim_use_all_actions=False"


WHOLE = TWO_TAKES + f"save({NLA})"
TV = "scene.render.fps, scene.render.fps_base = 30, 1.001\n"


@pytest.mark.parametrize(
    ("code", "counts", "fps", "read_at"),
    [
        (TWO_TAKES + f"save({NLA}, bake_anim_use_all_bones=False)", (9, 6), 24.0, None),
        (TWO_TAKES + f"save({NLA}, bake_anim_step=0.5)", (17, 11), 48.0, 24),
        (TV + WHOLE, (9, 6), 30 / 1.001, None),
    ],
    ids=["some bones", "between the frames of the file", "a rate of television"],
)
def test_takes_are_what_blender_shows(tmp_path, code, counts, fps, read_at):
    path = export(tmp_path / "a.fbx", code)
    model = as_blender_shows(path)
    assert [(c.name, c.n_frames) for c in model.clips] == list(
        zip(("first", "second"), counts, strict=True)
    )
    assert model.fps == pytest.approx(fps, rel=1e-9)
    alone = ssdr.load_skinning(path, clip="second")
    rest = alone.transforms[:, 0] - np.eye(3, 4)
    assert np.abs(rest).max() < 1e-5  # the first bone stands still in the second take
    back = ssdr.load_skinning(path, fps=read_at)
    assert [c.n_frames for c in back.clips] == [9, 6]
    whole = ssdr.load_skinning(export(tmp_path / "b.fbx", WHOLE))
    np.testing.assert_allclose(back.skin(), whole.skin(), atol=1e-5)


def test_takes_whose_names_blender_cuts_to_one_are_not_mixed_up(tmp_path):
    code = TWO_TAKES + f"r.name = 'a' * 300\nsave({NLA})"
    path = export(tmp_path / "a.fbx", code)
    refused = ""
    try:
        clips = ssdr.load_skinning(path).clips
    except ssdr.FormatError as error:
        refused = str(error)
    if refused:
        assert re.search(r"a\.fbx: .*takes that Blender can tell apart were expected", refused)
    else:  # Blender 5 holds longer names
        assert [(c.name, c.n_frames) for c in clips] == [("first", 9), ("second", 6)]
