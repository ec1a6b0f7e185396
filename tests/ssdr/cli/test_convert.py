"""`ssdr convert`."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.command import model_of


def test_a_skinning_is_kept_or_baked(run, done, refused, wave, tmp_path):
    model = model_of(wave)
    source, target = tmp_path / "m.npz", tmp_path / "n.npz"
    ssdr.save(model, source)
    assert done("convert", source, target)["kind"] == "skinning"
    np.testing.assert_array_equal(ssdr.load_skinning(target).transforms, model.transforms)
    flags = ("--bake", "--write", "npz:compress=false", "--write", "glb:weights=uint8")
    assert run("convert", source, target, *flags)[0] == 0
    with pytest.raises(ssdr.FormatError):
        ssdr.load_skinning(target)
    np.testing.assert_array_equal(ssdr.load(target).vertices, model.skin())
    assert "for a MeshSequence" in refused("convert", target, tmp_path / "w.glb")


@pytest.mark.parametrize("suffix", [".npz", ".glb"])
def test_lengths_are_scaled(done, clip, wave, tmp_path, suffix):
    model = model_of(wave)
    model.transforms[:, 0, :, 3] = np.arange(3 * wave.n_frames).reshape(-1, 3)
    source, target = tmp_path / f"model{suffix}", tmp_path / "scaled.npz"
    ssdr.save(model, source)
    done("convert", source, target, "--read", "scale=10")
    back = ssdr.load_skinning(target)
    assert back.n_bones == ssdr.load_skinning(source).n_bones
    np.testing.assert_allclose(back.skin(), 10 * model.skin(), rtol=1e-5, atol=1e-5)
    done("convert", clip, target, "--read", "scale=0.01")
    np.testing.assert_allclose(ssdr.load(target).vertices, wave.vertices / 100, rtol=1e-6)
