"""Blender as an independent importer of what is written, and as a reader of FBX."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers.blender_scene import needs_blender
from helpers.rig_model import largest_distance, tube
from ssdr.io.blender.fbx_reading import SCRIPT
from ssdr.io.blender.finder import run


def imported(path, fps=24.0):
    """World vertices with y up, as Blender's own importer sees the file."""
    job = {"action": "read", "path": str(path), "fps": fps, "resample": False, "max_bytes": 1 << 30}
    arrays = run(SCRIPT, job, time_limit=600)
    return arrays["vertices"][..., [0, 2, 1]] * [1, 1, -1], arrays


@needs_blender
@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"scaled": True}, {"bones": 9, "influences": 7}])
def test_blender_plays_our_gltf(tmp_path, options):
    model = tube(**options)
    ssdr.save(model, tmp_path / "a.glb")
    vertices, arrays = imported(tmp_path / "a.glb")
    truth = model.skin()[:, arrays["vertex"]]
    assert vertices.shape == truth.shape
    assert largest_distance(vertices, truth) < 1e-6 * 6
    assert len(arrays["faces"]) == len(model.faces)
    np.testing.assert_array_equal(
        np.bincount(arrays["surface_material_index"]), np.bincount(model.surface.material_index)
    )
    assert arrays["texture_0"].tobytes() == model.surface.materials[0].texture


@needs_blender
@pytest.mark.slow
def test_blender_plays_our_usd(tmp_path):
    pytest.importorskip("pxr.UsdSkel", reason="usd-core is not installed")
    model = tube()
    ssdr.save(model, tmp_path / "a.usdc")
    vertices, _ = imported(tmp_path / "a.usdc")
    assert largest_distance(vertices, model.skin()) < 1e-6 * 6
    cache = ssdr.MeshSequence(model.skin(), model.faces, 24)
    ssdr.save(cache, tmp_path / "b.usdc")
    vertices, _ = imported(tmp_path / "b.usdc")
    assert largest_distance(vertices, model.skin()) < 1e-6 * 6


@needs_blender
@pytest.mark.slow
def test_damaged_files_are_blamed_on_the_file(tmp_path, monkeypatch):
    path = tmp_path / "a.fbx"
    path.write_bytes(b"Kaydara FBX Binary  \x00\x1a\x00" + b"\xff" * 200)
    with pytest.raises(ssdr.FormatError, match=r"a\.fbx: Blender says: "):
        ssdr.load(path)
    path.write_bytes(b"; FBX 7.4\n")
    said = r"a\.fbx: Blender says: ASCII FBX files are not supported"
    with pytest.raises(ssdr.FormatError, match=said):
        ssdr.load(path)
    (tmp_path / "endless.py").write_text("import threading\nthreading.Event().wait()")
    monkeypatch.setattr("ssdr.io.blender.fbx_reading.SCRIPT", tmp_path / "endless.py")
    with pytest.raises(ssdr.FormatError, match=r"more than 0\.1 s"):
        ssdr.load(path, time_limit=0.1)


@needs_blender
def test_mislabelled_files_never_reach_blender(tmp_path):
    (tmp_path / "a.fbx").write_bytes(b"PK\x03\x04" * 9)
    with pytest.raises(ssdr.FormatError, match="zip"):
        ssdr.load(tmp_path / "a.fbx")


def test_fbx_refuses_mixed_rates_by_name(tmp_path):
    clips = [ssdr.Clip("walk", 0, 9, 24.0), ssdr.Clip("jump", 9, 20, 60.0)]
    model = dataclasses.replace(tube(), clips=clips)
    with pytest.raises(ssdr.InputError, match=r"one frame rate.*walk at 24, jump at 60"):
        ssdr.save(model, tmp_path / "a.fbx")
    named = [dataclasses.replace(c, name=c.name * 20, fps=24.0) for c in clips]
    with pytest.raises(ssdr.InputError, match=r"at most 63 bytes.*walkwalk"):
        ssdr.save(dataclasses.replace(model, clips=named), tmp_path / "a.fbx")
