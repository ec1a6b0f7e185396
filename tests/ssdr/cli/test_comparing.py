"""`ssdr compare`."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

import ssdr


def test_compare_measures(run, clip, wave, tmp_path):
    moved = dataclasses.replace(wave, vertices=wave.vertices + np.float32([0, 0, 0.5]))
    ssdr.save(moved, tmp_path / "b.npz")
    code, out, err = run("compare", clip, tmp_path / "b.npz", "--json", "--no-sted")
    assert code == 0, err
    assert json.loads(out)["rmse"] == pytest.approx(0.5)
    code, out, _ = run("compare", clip, tmp_path / "b.npz", "--no-hausdorff", "--no-sted")
    assert code == 0
    assert "0.5" in out


def test_compare_spreads_a_welded_model_back(run, seam, tmp_path):
    welded, _ = seam.weld()
    ssdr.save(seam, tmp_path / "a.npz")
    ssdr.save(welded, tmp_path / "b.npz")
    for pair in (("a.npz", "b.npz"), ("b.npz", "a.npz")):
        code, out, err = run("compare", *(tmp_path / p for p in pair), "--json")
        assert code == 0, err
        assert json.loads(out)["rmse"] == 0
    other = ssdr.MeshSequence(seam.vertices[:, :7])
    ssdr.save(other, tmp_path / "c.npz")
    code, _, err = run("compare", tmp_path / "a.npz", tmp_path / "c.npz")
    assert code == 2
    assert "--weld" in err
