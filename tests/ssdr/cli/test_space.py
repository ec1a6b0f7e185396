"""Units and up axes on the command line."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from PIL import Image

import ssdr
from helpers.rig_model import largest_distance, tube
from ssdr import Space
from ssdr.io import in_space


@pytest.fixture
def there():
    return dataclasses.replace(tube(bones=3, frames=6, rings=7, sides=6), space=Space(1.0, "y"))


@pytest.fixture
def stage(there, tmp_path):
    pytest.importorskip("pxr.UsdSkel")
    ssdr.save(in_space(there, Space(0.01, "z")), tmp_path / "cm.usdc")
    return tmp_path / "cm.usdc"


def test_info_shows_what_a_file_states(run, done, stage, tmp_path):
    document = done("info", stage)
    assert (document["units"], document["up"]) == (0.01, "z")
    assert "0.01 m a unit, z up" in run("info", stage)[1]
    document = done("info", ssdr.samples.path("dancer_small"))
    assert (document["units"], document["up"]) == (None, None)
    assert "unit not stated, up axis not stated" in run("info", "sample:dancer_small")[1]
    assert "0.0254 m a unit, y up" in run("info", stage, "--units", "in", "--up", "y")[1]


def test_two_spaces_are_compared_in_one(run, done, there, stage, tmp_path):
    ssdr.save(there, tmp_path / "m.glb")
    document = done("compare", tmp_path / "m.glb", stage, "--no-sted", "--no-hausdorff")
    (said,) = document["warnings"]
    assert said.startswith("A is in 1 m a unit, y up, B in 0.01 m a unit, z up: compared in 1 m")
    assert document["rmse"] < 1e-6
    back = done("compare", stage, tmp_path / "m.glb", "--no-sted", "--no-hausdorff")
    assert back["rmse"] < 1e-4  # in centimetres
    same = done("compare", stage, stage, "--no-sted", "--no-hausdorff")
    assert (same["warnings"], same["rmse"]) == ([], 0)


def test_what_is_said_beats_what_is_stated(done, refused, there, stage, tmp_path):
    out = tmp_path / "a.glb"
    document = done("convert", stage, out)
    notes = document["output"]["notes"]
    assert "converted from 0.01 m a unit, z up to 1 m a unit, y up" in notes
    assert largest_distance(ssdr.load(out).vertices, there.skin()) < 1e-6
    done("convert", stage, out, "--units", "mm", "--up", "y")
    size, up = np.ptp(ssdr.load(out).vertices[0], axis=0), np.ptp(there.skin()[0], axis=0)
    np.testing.assert_allclose(size, up[[0, 2, 1]] / 10, rtol=1e-5)
    # not the rest of the file around a model that is elsewhere
    done("convert", stage, tmp_path / "b.usdc", "--units", "1")
    assert ssdr.load(tmp_path / "b.usdc").space == Space(1.0, "z")
    for odd, word in (("--units", "ell"), ("--units", "-1"), ("--up", "x")):
        assert odd in (err := refused("info", stage, odd, word)) or "units: expected" in err


def test_a_rig_and_a_start_come_into_the_space_of_the_input(done, there, stage, tmp_path):
    rig = dataclasses.replace(there, parents=[-1, 0, 1], joint_positions=there.centroids())
    ssdr.save(rig, tmp_path / "rig.glb")
    for option, bones in (("--rig", ()), ("--start", ("-b", 3))):
        words = (option, tmp_path / "rig.glb", "--effort", "fast", *bones)
        document = done("decompose", stage, "-o", tmp_path / "o.npz", *words)
        assert document["rmse_percent"] < 1, option


def test_a_picture_stands_on_the_axis_of_its_file(run, stage, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(
        "ssdr.render.figures.contact_sheet",
        lambda *_, up, **__: seen.append(up) or Image.new("RGB", (4, 4)),
    )
    for words in ((), ("--up", "y")):
        code, _, err = run("render", stage, "-o", tmp_path / "a.png", *words)
        assert code == 0, err
    run("render", "sample:dancer_small", "-o", tmp_path / "a.png")
    assert seen == ["z", "y", "y"]
