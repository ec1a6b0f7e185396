"""Objects that mirror their mesh, and keys between frames, in files that Blender has written."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.blender_scene import export, needs_blender

_SCENE = """
item = strip("sheet", None)
item.scale = (-1, 1, 1)
item.keyframe_insert("location", frame=0)
item.location = (0, 0, 1)
item.keyframe_insert("location", frame=5)
scene.frame_end = 5
save(bake_anim=True)
"""


@needs_blender
@pytest.mark.slow
@pytest.mark.parametrize("read", [ssdr.load, ssdr.load_skinning])
def test_a_mirrored_object_keeps_its_outside(tmp_path, read):
    thing = read(export(tmp_path / "a.fbx", _SCENE))
    points = (thing.vertices if read is ssdr.load else thing.skin())[0]
    p = points[thing.faces]
    across = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    assert ((across[:, None] * thing.surface.normals).sum(axis=-1) > 0).all()


_KEYS = """
item = strip("sheet", None)
for frame, x in ((0, 0), (1.3, 1), (4.7, -1), (9.6, 2)):
    item.location = (x, 0, 0)
    item.keyframe_insert("location", frame=frame)
scene.frame_end = 10
save(bake_anim=True, bake_anim_step=0.013)
"""


@needs_blender
@pytest.mark.slow
@pytest.mark.parametrize("read", [ssdr.load, ssdr.load_skinning])
def test_keys_between_frames_are_said(tmp_path, read):
    path = export(tmp_path / "a.fbx", _KEYS)
    with pytest.warns(ssdr.SsdrWarning, match=r"keys of the clip .* lie between .* % of the"):
        read(path)
    read(path, fps=24)
