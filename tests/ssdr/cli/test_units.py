"""Units: a pair in metres and centimetres gets a hint, and --scale brings one to the other."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

import ssdr
from helpers.command import model_of


@pytest.fixture
def pair(wave, tmp_path):
    ssdr.save(wave, tmp_path / "metres.npz")
    large = dataclasses.replace(wave, vertices=wave.vertices * np.float32(100))
    ssdr.save(large, tmp_path / "centimetres.npz")
    return tmp_path / "metres.npz", tmp_path / "centimetres.npz"


def compared(run, *arguments):
    code, out, err = run("compare", *arguments, "--json", "--no-sted", "--no-hausdorff")
    assert code == 0, err
    return json.loads(out)


def test_metres_and_centimetres_get_a_hint(run, pair):
    metres, centimetres = pair
    (hint,) = compared(run, metres, centimetres)["warnings"]
    assert "the diagonal of B is about 100 times that of A" in hint
    assert "--scale 0.01 brings B to A" in hint
    (hint,) = compared(run, centimetres, metres)["warnings"]
    assert "the diagonal of A is about 100 times that of B" in hint
    assert "--scale 100 brings" in hint
    out = run("compare", metres, centimetres, "--no-sted", "--no-hausdorff")[2]
    assert "--scale 0.01" in out
    assert compared(run, metres, metres)["warnings"] == []


def test_scale_brings_one_to_the_other(run, pair):
    metres, centimetres = pair
    found = compared(run, metres, centimetres, "--scale", "0.01")
    assert found["warnings"] == []
    assert found["rmse"] == pytest.approx(0, abs=1e-6)
    for wrong in ("0", "-1", "nan", "inf"):
        code, _, err = run("compare", metres, centimetres, "--scale", wrong)
        assert code == 2
        assert "--scale" in err


def test_a_size_between_two_powers_gets_none(run, wave, pair, tmp_path):
    # a mesh of another size is no mesh of another unit
    other = dataclasses.replace(wave, vertices=wave.vertices * np.float32(30))
    ssdr.save(other, tmp_path / "other.npz")
    assert compared(run, pair[0], tmp_path / "other.npz")["warnings"] == []


def test_convert_scales_vertices(run, wave, pair, tmp_path):
    target = tmp_path / "small.npz"
    code, _, err = run("convert", pair[1], target, "--scale", "0.01")
    assert code == 0, err
    np.testing.assert_allclose(ssdr.load(target).vertices, wave.vertices, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("suffix", [".npz", ".glb"])
def test_convert_scales_a_skinning(run, wave, tmp_path, suffix):
    model = model_of(wave)
    model.transforms[:, 0, :, 3] = np.arange(3 * wave.n_frames).reshape(-1, 3)
    source, target = tmp_path / f"model{suffix}", tmp_path / "scaled.npz"
    ssdr.save(model, source)
    code, _, err = run("convert", source, target, "--scale", "10")
    assert code == 0, err
    back = ssdr.load_skinning(target)
    assert back.n_bones == ssdr.load_skinning(source).n_bones
    np.testing.assert_allclose(back.skin(), 10 * model.skin(), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(ssdr.load(source, scale=10).vertices, back.skin(), rtol=1e-5)


@pytest.mark.usefixtures("faked")
def test_decompose_scales_its_input(run, pair, tmp_path):
    target = tmp_path / "out.npz"
    code, out, err = run("decompose", pair[1], "-b", 2, "-o", target, "--scale", 0.01, "--json")
    assert code == 0, err
    assert json.loads(out)["diagonal"] == pytest.approx(ssdr.load(pair[0]).diagonal(), rel=1e-5)


def test_scale_of_what_stays_on_disk(wave, tmp_path):
    ssdr.save(wave, tmp_path / "a.npy")
    found = ssdr.load(tmp_path / "a.npy", mmap=True, scale=2)
    np.testing.assert_array_equal(found.vertices, 2 * wave.vertices)
    for wrong in (0, -1.0, float("nan"), "2", True):
        with pytest.raises(ssdr.InputError, match="scale"):
            ssdr.load(tmp_path / "a.npy", scale=wrong)
