"""`ssdr decompose`: arguments, outputs, table and JSON, going on from a model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import ssdr
from helpers.command import fake_decompose, model_of


def test_outputs_and_json(faked, done, clip, wave, tmp_path):
    outputs = [tmp_path / "a.npz", tmp_path / "b.pc2"]
    picture = tmp_path / "sheet.png"
    document = done(
        "decompose", clip, *(f for o in outputs for f in ("-o", o)), "--bones", 3, "-k", 2,
        "-o", picture, "--checkpoint", tmp_path / "c.npz", "--time-limit", 9, "--seed", 5,
        "--effort", "fast", "--smoothness", 0.1, "--rest-pose", "free", "--no-normals",
    )  # fmt: skip
    assert (document["bones"], document["influences"], document["rmse"]) == (3, 2, 0.25)
    assert document["E"] == pytest.approx(250 / np.sqrt(3))
    assert document["rmse_percent"] == pytest.approx(25 / wave.diagonal())
    # the fake keeps the rest pose: the largest error is the longest way from the first frame
    way = np.linalg.norm(wave.vertices - wave.vertices[0], axis=2).max()
    assert document["max_error"] == pytest.approx(way)
    assert document["max_error_percent"] == pytest.approx(100 * way / wave.diagonal())
    assert document["stop_reason"] == "converged"
    assert document["total_seconds"] >= document["load_seconds"] + document["save_seconds"]
    assert [o["path"] for o in document["outputs"]] == [str(o) for o in [*outputs, picture]]
    assert all(o["bytes"] == Path(o["path"]).stat().st_size for o in document["outputs"])
    assert fake_decompose.options == {
        "effort": "fast",
        "bone_model": "rigid",
        "rest_pose": "free",
        "normals": False,
        "rig": None,
        "start": None,
        "rng": 5,
        "time_limit": 9.0,
        "smoothness": 0.1,
        "checkpoint": tmp_path / "c.npz",
    }
    assert ssdr.load_skinning(outputs[0]).n_bones == 3
    with Image.open(picture) as image:
        assert image.width == 1600


def test_the_table_tells_error_and_files_and_quiet_tells_nothing(faked, run, clip, tmp_path):
    code, out, err = run("decompose", clip, "-o", tmp_path / "a.npz", "-b", 2)
    assert (code, err) == (0, "")
    for text in (
        "RMSE",
        "largest ",
        "% of the diagonal",
        "E ",
        "the search converged",
        "a.npz",
        "2 bones",
    ):
        assert text in out
    quiet = ("decompose", clip, "-o", tmp_path / "b.npz", "-b", 2, "--quiet")
    assert run(*quiet) == (0, "", "")


def test_weld_travels_to_the_model(faked, done, seam, tmp_path):
    ssdr.save(seam, tmp_path / "seam.npz")
    out = tmp_path / "a.npz"
    done("decompose", tmp_path / "seam.npz", "-o", out, "-b", 1, "--read", "weld=true")
    model = ssdr.load_skinning(out)
    assert model.n_vertices == 15
    assert len(model.vertex_map) == seam.n_vertices


@pytest.mark.filterwarnings("ignore:.*no loss:ssdr.SsdrWarning")
def test_a_model_to_start_from_says_how_many_bones(done, refused, clip, wave, tmp_path):
    model, out = tmp_path / "model.npz", tmp_path / "out.npz"
    ssdr.save(model_of(wave), model)
    line = ("decompose", clip, "-o", out, "--effort", "fast")
    assert done(*line, "--start", model)["bones"] == 2
    assert "--rig FILE or --start MODEL" in refused(*line)
    assert "bones: expected an integer" in refused(*line, "--start", clip)


def test_normals_are_those_that_the_file_is_drawn_with(run, done, clip, wave, tmp_path):
    file = tmp_path / "a.glb"
    arguments = ("decompose", clip, "-o", file, "-b", 3, "--effort", "fast")
    found = done(*arguments)["normals"]
    there = ssdr.metrics.normals(wave, ssdr.load_skinning(file)).as_dict()
    assert found == pytest.approx(there, rel=1e-3)
    assert "% inwards, as engines draw them" in run(*arguments)[1]
