"""`ssdr decompose`: files, tables, progress, interruption."""

from __future__ import annotations

import json
import shlex
import signal
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import ssdr
from helpers.command import FAKED, FakeState, fake_decompose, start, wait_for


def test_what_a_tolerance_bounds_needs_one(run, clip, tmp_path):
    code, out, err = run(
        "decompose", clip, "-o", tmp_path / "a.npz", "--bones", 2, "--tolerance-of", "max"
    )
    assert (code, out) == (2, "")
    assert "tolerance_of" in err
    assert not (tmp_path / "a.npz").exists()


def test_decompose_writes_all_outputs_and_tells_json(faked, run, clip, wave, tmp_path):
    outputs = [tmp_path / "a.npz", tmp_path / "b.pc2", tmp_path / "w.csv"]
    flags = [f for o in outputs for f in ("-o", o)]
    picture, state = tmp_path / "sheet.png", tmp_path / "end.npz"
    code, out, err = run(
        "decompose",
        clip,
        *flags,
        "--bones",
        3,
        "--influences",
        2,
        "--picture",
        picture,
        "--checkpoint",
        state,
        "--time-limit",
        9,
        "--seed",
        5,
        "--effort",
        "fast",
        "--json",
    )
    assert code == 0, err
    document = json.loads(out)
    assert document["bones"] == 3
    assert document["influences"] == 2
    assert document["rmse"] == 0.25
    assert document["E"] == pytest.approx(250 / np.sqrt(3))
    assert document["rmse_percent"] == pytest.approx(25 / wave.diagonal())
    assert document["stop_reason"] == "converged"
    assert [o["path"] for o in document["outputs"]] == [str(o) for o in outputs]
    assert all(o["bytes"] == Path(o["path"]).stat().st_size for o in document["outputs"])
    # loading is over, and saving is still to come
    left = fake_decompose.options["time_limit"]
    assert 0 < left < 9.0
    assert fake_decompose.options == {
        "effort": "fast",
        "bone_model": "rigid",
        "hierarchy": "none",
        "rest_frame": 0,
        "rng": 5,
        "time_limit": left,
        "max_iterations": None,
        "smoothness": 0.0,
        "checkpoint": state,
    }
    assert ssdr.load_skinning(outputs[0]).n_bones == 3
    assert FakeState.load(state).steps == 3
    with Image.open(picture) as image:
        assert image.width == 1600
    assert err == ""


def test_decompose_prints_a_table_and_plain_progress(faked, run, clip, tmp_path):
    code, out, err = run("decompose", clip, "-o", tmp_path / "a.npz", "-b", 2)
    assert code == 0
    for text in ("RMSE", "% of the diagonal", "E ", "converged", "a.npz", "2 bones"):
        assert text in out
    assert "alternate" in err
    assert "RMSE 1" in err
    code, out, err = run("decompose", clip, "-o", tmp_path / "b.npz", "-b", 2, "--quiet")
    assert (code, out, err) == (0, "", "")


def test_weld_travels_to_the_model(faked, run, seam, tmp_path):
    ssdr.save(seam, tmp_path / "seam.npz")
    code, _, err = run(
        "decompose",
        tmp_path / "seam.npz",
        "-o",
        tmp_path / "a.npz",
        "-b",
        1,
        "--weld",
        "--picture",
        tmp_path / "a.png",
        "-q",
    )
    assert code == 0, err
    model = ssdr.load_skinning(tmp_path / "a.npz")
    assert model.n_vertices == 15
    assert len(model.vertex_map) == seam.n_vertices


def test_the_result_survives_a_disk_that_fails(faked, run, clip, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(ssdr, "save", full)
    code, _, err = run("decompose", clip, "-b", 2, "-o", tmp_path / "a.npz")
    assert code == 1
    assert "No space left" in err
    assert FakeState.load(tmp_path / "a.state.npz").steps == 3


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_ctrl_c_leaves_a_state_to_resume_from(number, clip, tmp_path):
    def faked(steps):
        return ["-c", FAKED.format(steps=steps)]

    out = tmp_path / "a.npz"
    work = ["decompose", clip, "-o", out, "--bones", 2]
    process = start([*faked(100_000), *work])
    wait_for(process, "alternate")
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert not out.exists()
    state = tmp_path / "a.state.npz"
    assert FakeState.load(state).steps >= 1
    command = shlex.split(err.strip().splitlines()[-1].partition("go on with: ")[2])
    assert command == ["ssdr", *map(str, work), "--resume", str(state)]
    process = start([*faked(FakeState.load(state).steps + 2), *command[1:]])
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert out.exists()


def test_second_ctrl_c_quits_at_once(clip, tmp_path):
    code = FAKED.format(steps=100_000).replace("0.02", "60")
    process = start(["-c", code, "decompose", clip, "-o", tmp_path / "a.npz", "--bones", 2])
    wait_for(process, "asleep")
    process.send_signal(signal.SIGINT)
    wait_for(process, "again to quit")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=20)
    assert process.returncode == 130
    assert [p.name for p in tmp_path.iterdir()] == ["clip.npz"]


@pytest.mark.slow
def test_the_real_solver_is_interrupted_and_resumed(tmp_path):
    """The whole way on the sample: two formats, a picture, Ctrl-C, resume."""
    clip = ssdr.samples.path("dancer_small")
    out, model = tmp_path / "a.glb", tmp_path / "b.npz"
    work = ["decompose", clip, "-o", out, "-o", model, "-b", 12, "--effort", "best"]
    process = start(["-m", "ssdr", *work])
    wait_for(process, "RMSE")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert not out.exists()
    last = err.strip().splitlines()[-1]
    before = float(last.partition("RMSE ")[2].partition(";")[0])
    command = shlex.split(last.partition("go on with: ")[2])
    assert command[-1] == str(tmp_path / "a.state.npz")
    more = ("--json", "--time-limit", "4", "--picture", str(tmp_path / "a.png"))
    process = start(["-m", "ssdr", *command[1:], *more])
    text, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    document = json.loads(text)
    sequence = ssdr.load(clip)
    back = ssdr.load_skinning(model)
    assert (back.n_bones, back.n_influences) == (12, 4)
    gap = back.skin().astype(np.float64) - sequence.vertices
    rmse = np.sqrt((gap**2).sum() / gap[..., 0].size)
    assert document["rmse"] == pytest.approx(rmse, rel=1e-3)
    assert rmse <= before * (1 + 1e-3)
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.width == 1600
