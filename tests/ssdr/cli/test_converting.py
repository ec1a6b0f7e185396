"""`ssdr convert`."""

from __future__ import annotations

import json

import numpy as np
import pytest

import ssdr
from helpers.command import model_of


def test_convert_keeps_a_skinning_or_bakes_it(run, wave, tmp_path):
    model = model_of(wave)
    ssdr.save(model, tmp_path / "m.npz")
    code, out, err = run("convert", tmp_path / "m.npz", tmp_path / "n.npz", "--json")
    assert code == 0, err
    assert json.loads(out)["kind"] == "skinning"
    np.testing.assert_array_equal(
        ssdr.load_skinning(tmp_path / "n.npz").transforms, model.transforms
    )
    assert run("convert", tmp_path / "m.npz", tmp_path / "n.npz")[0] == 2
    flags = ("--bake", "--force", "--write", "npz:compress=false", "--write", "glb:weights=uint8")
    assert run("convert", tmp_path / "m.npz", tmp_path / "n.npz", *flags)[0] == 0
    with pytest.raises(ssdr.FormatError):
        ssdr.load_skinning(tmp_path / "n.npz")
    np.testing.assert_array_equal(ssdr.load(tmp_path / "n.npz").vertices, model.skin())
    code, out, err = run("convert", tmp_path / "n.npz", tmp_path / "w.csv")
    assert code == 2
    assert "sequence of vertices" in err
