"""Blender as an independent importer of what is written."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.blender_scene import blender_shows, needs_blender
from helpers.rig_model import largest_distance, tube


@needs_blender
@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"scaled": True}, {"bones": 9, "influences": 7}])
def test_blender_plays_our_gltf(tmp_path, options):
    model = tube(**options)
    ssdr.save(model, tmp_path / "a.glb")
    vertices, arrays = blender_shows(tmp_path / "a.glb", model.n_frames)
    truth = model.skin()[:, arrays["vertex"]]
    assert largest_distance(vertices, truth) < 1e-6 * 6
    materials = np.bincount(model.surface.material_index)
    np.testing.assert_array_equal(np.bincount(arrays["materials"]), materials)
    assert arrays["pictures"].tolist() == [model.surface.materials[0].texture]


@needs_blender
@pytest.mark.slow
def test_blender_plays_our_usd(tmp_path):
    pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")
    model = tube()
    cache = ssdr.MeshSequence(model.skin(), model.faces, 24)
    for thing, path in ((model, tmp_path / "a.usdc"), (cache, tmp_path / "b.usdc")):
        ssdr.save(thing, path)
        vertices, _ = blender_shows(path, model.n_frames)
        assert largest_distance(vertices, model.skin()) < 1e-6 * 6


def test_fbx_refuses_mixed_rates_by_name(tmp_path):
    clips = [ssdr.Clip("walk", 0, 9, 24.0), ssdr.Clip("jump", 9, 20, 60.0)]
    model = dataclasses.replace(tube(), clips=clips)
    with pytest.raises(ssdr.InputError, match=r"one frame rate.*walk at 24, jump at 60"):
        ssdr.save(model, tmp_path / "a.fbx")
    named = [dataclasses.replace(c, name=c.name * 20, fps=24.0) for c in clips]
    with pytest.raises(ssdr.InputError, match=r"at most 63 bytes.*walkwalk"):
        ssdr.save(dataclasses.replace(model, clips=named), tmp_path / "a.fbx")
