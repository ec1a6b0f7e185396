import json

import numpy as np
import pytest

pytest.importorskip("torch")

from typer.testing import CliRunner

from garmentnet.cli import app
from ssdr.errors import FormatError, InputError

RUN = CliRunner()


def call(*arguments):
    """Run the command in this process; its output, or the error that it raised."""
    result = RUN.invoke(app, [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.stdout


def test_train_then_evaluate_then_predict(toy_store, tmp_path, monkeypatch):
    monkeypatch.setenv("GARMENTNET_DATA", str(tmp_path / "data"))
    (tmp_path / "c.toml").write_text(
        "[bones]\nlength = 0.03\ncount = 10\ninfluences = 4\neffort = 'fast'\nframes = 160\n"
        "[low]\nhidden = 16\n[high]\nhidden = 8\n"
        "[train]\nepochs = 2\nhigh_epochs = 1\nthreads = 1\ntensorboard = false\n"
    )
    out = call("train", tmp_path / "c.toml", "--store", toy_store.path, "--seed", 3)
    checkpoint = tmp_path / "data" / "runs" / "c-seed3" / "checkpoint.safetensors"
    assert out.strip() == str(checkpoint)

    out = call("evaluate", checkpoint, "--store", toy_store.path, "--pictures", 0)
    assert "Santesteban 2019" in out
    report = json.loads((tmp_path / "data" / "evaluation" / "report.json").read_text())
    names = [r["name"] for r in report["unseen_motions"]]
    assert names[0] == "bones themselves"
    assert {"mean shape", "body-skinned", "ridge", "Santesteban 2019"} <= set(names)

    motion = toy_store.path / "clips" / "base-test-0"
    out = call("predict", checkpoint, motion, "-o", tmp_path / "dress.npz")
    assert "90 frames of vertices" in out
    with np.load(tmp_path / "dress.npz") as archive:
        assert any(archive[k].shape == (90, 112, 3) for k in archive.files)
    with pytest.raises(InputError, match="single network"):
        call("predict", checkpoint, motion, "--bending", 2, "-o", tmp_path / "dress.npz")


def test_clear_errors(toy_run, toy_store, tmp_path):
    checkpoint = toy_run / "checkpoint.safetensors"
    with pytest.raises(InputError, match="--store"):
        call("train", "rooted")
    with pytest.raises(InputError, match="config"):
        call("train", "no-such-preset", "--store", toy_store.path)
    with pytest.raises(FormatError, match="no such folder"):
        call("train", "rooted", "--store", tmp_path / "nothing")
    with pytest.raises(InputError, match="--output"):
        call("predict", checkpoint, "m.bvh", "-o", tmp_path / "no" / "folder.gif")
    with pytest.raises(FormatError, match="setting"):
        call("train", "rooted", "--store", toy_store.path, "--set", "train.sed=1")
