import json
import os
import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from garmentnet.cli import app, main
from garmentnet.configs.config import load_config
from garmentnet.paper.bones import virtual_bones

RUN = CliRunner()
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}


def settings(folder, *, low=16, epochs=2, high_epochs=1, device=""):
    """A file of settings for networks that are small and quick."""
    (folder / "c.toml").write_text(
        "[bones]\nlength = 0.03\ncount = 10\ninfluences = 4\neffort = 'fast'\nframes = 160\n"
        f"[low]\nhidden = {low}\n[high]\nhidden = 8\n"
        f"[train]\nepochs = {epochs}\nhigh_epochs = {high_epochs}\nthreads = 1\n"
        + (f"device = '{device}'\n" if device else "")
    )
    return folder / "c.toml"


def call(*arguments):
    """Run the command in this process; its output, or the error that it raised."""
    result = RUN.invoke(app, [str(a) for a in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_a_clip_is_shown_beside_its_prediction(toy_run, toy_store, tmp_path):

    checkpoint = toy_run / "checkpoint.safetensors"
    sizes = {}
    # The second is simulated with other parameters: not what the network was asked for.
    for name in ("base-test-0", "set0-test-0"):
        path = tmp_path / f"{name}.png"
        call("predict", checkpoint, toy_store.clip(name).path, "-o", path)
        with Image.open(path) as sheet:
            sizes[name] = sheet.height
    assert sizes["base-test-0"] > 2 * sizes["set0-test-0"]


def test_train_then_evaluate_then_predict(short_store, tmp_path, monkeypatch):
    monkeypatch.setenv("GARMENTNET_DATA", str(tmp_path / "data"))
    out = call("train", settings(tmp_path), "--store", short_store.path, "--set", "train.seed=3")
    checkpoint = tmp_path / "data" / "runs" / "c-seed3" / "checkpoint.safetensors"
    assert out.strip() == str(checkpoint)

    out = call("evaluate", checkpoint, "--store", short_store.path, "--pictures", 0)
    assert "| mean shape " in out
    report = json.loads((tmp_path / "data" / "evaluation" / "report.json").read_text())
    names = [r["name"] for r in report["groups"]["test"]["rows"]]
    assert names[0] == "bones themselves"
    assert names[-4:] == ["mean shape", "body-skinned", "ridge", "chaos of the cloth"]
    motion = short_store.clip("base-test-0").path
    out = call("predict", checkpoint, motion, "-o", tmp_path / "dress.npz")
    assert "40 frames of vertices" in out
    with np.load(tmp_path / "dress.npz") as archive:
        assert any(archive[k].shape == (40, 112, 3) for k in archive.files)


def said(capfd, *arguments):
    """What a user sees of a failure: exit code and the one line on stderr."""
    code = main([str(a) for a in arguments])
    lines = [x for x in capfd.readouterr().err.splitlines() if x.startswith("garmentnet: ")]
    assert len(lines) == 1, lines
    return code, lines[0]


def test_every_failure_is_one_line(toy_run, toy_store, tmp_path, capfd):
    """Arguments end with 2, files with 3; each line names what is wrong."""
    checkpoint = toy_run / "checkpoint.safetensors"
    joints = np.array(toy_store.clip("base-test-0").joints)
    joints[3, 1, 0, 3] = np.nan
    np.savez(tmp_path / "nan.npz", joints=joints)
    (tmp_path / "hostile.safetensors").write_bytes(pickle.dumps({"format": "garmentnet"}))
    clip = toy_store.clip("base-test-0").path
    out = tmp_path / "x.npz"
    cases = [
        (3, r"nan\.npz.* frame 3, joint 1", checkpoint, tmp_path / "nan.npz", "-o", out),
        (3, r"hostile\.safetensors", tmp_path / "hostile.safetensors", clip, "-o", out),
        (2, "nothing", tmp_path / "nothing.safetensors", clip, "-o", out),
        (2, "a suffix of .*webp", checkpoint, clip, "-o", tmp_path / "x.xyz"),
        (2, "folder that exists", checkpoint, clip, "-o", tmp_path / "no" / "x.npz"),
        (
            2,
            "single network.*bending 0.5.*bending 2",
            checkpoint,
            clip,
            "--parameters",
            "bending=2",
            "-o",
            out,
        ),
        (
            2,
            "bending: expected a positive",
            checkpoint,
            clip,
            "--parameters",
            "bending=nan",
            "-o",
            out,
        ),
        (2, "--output", checkpoint, clip),
    ]
    exporting = [(2, "x.obj", checkpoint, "-o", tmp_path / "x.obj")]
    store = ("--store", toy_store.path)
    training = [
        (2, "--store", "rooted"),
        (2, "config", "no-such-preset", *store),
        (3, "no such folder", "rooted", "--store", tmp_path / "nothing"),
        (3, "not a store of clips", "rooted", "--store", toy_run),
        (3, "setting", "rooted", *store, "--set", "train.sed=1"),
    ]
    for command, rows in (("predict", cases), ("export", exporting), ("train", training)):
        for code, words, *arguments in rows:
            got = said(capfd, command, *arguments)
            assert got[0] == code, got
            assert re.search(words, got[1]), got
    assert not list(tmp_path.glob("x.*"))


HELD = """
import sys, threading
from garmentnet.cli import main
from garmentnet.training import loop
save = loop._save
def held(file, *rest):
    save(file, *rest)
    if file.name.startswith(sys.argv[1]):
        print(sys.argv[1], flush=True)
        threading.Event().wait()
loop._save = held
sys.exit(main(sys.argv[2:]))
"""


def test_killed_training_goes_on(short_store, tmp_path):
    """A real process, killed in the first module and again in the second."""
    file = settings(tmp_path, epochs=2, high_epochs=2, device="cpu")
    given = [str(file), "--store", str(short_store.path)]
    call("train", *given, "-o", tmp_path / "whole")
    cut = tmp_path / "cut"
    for state in ("low", "high"):
        process = subprocess.Popen(
            [sys.executable, "-c", HELD, state, "train", *given, "-o", str(cut)],
            env=ENVIRONMENT,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        with process:
            held = any(line == f"{state}\n" for line in process.stdout)
            process.kill()
        assert held
        assert not {"checkpoint.safetensors", "history.json"} & {p.name for p in cut.iterdir()}
    name = "checkpoint.safetensors"
    for _ in range(2):  # a run that is finished is left as it is
        call("train", *given, "-o", cut)
        assert (cut / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_limit_of_a_file_while_training(short_store, tmp_path):
    """A disk that takes no more: a state that cannot be written, and the one before it kept."""
    pytest.importorskip("resource")
    file = settings(tmp_path, low=128, epochs=1, device="cpu")
    virtual_bones(short_store, load_config(str(file)).bones)
    arguments = ["train", str(file), "--store", str(short_store.path)]
    # In a process of its own: the limit cannot be lifted again everywhere.
    code = (
        "import resource, signal, sys\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, resource.RLIM_INFINITY))\n"
        "from garmentnet.cli import main\n"
        f"sys.exit(main({[*arguments, '-o', str(tmp_path / 'run')]!r}))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env=ENVIRONMENT,
    )
    assert done.returncode == 1, done.stderr
    assert re.search(r"low\.state\.safetensors: File too large", done.stderr)
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["run.json"]


def test_a_garment_plays_with_its_joints(toy_run, toy_store, tmp_path):
    checkpoint, target = toy_run / "checkpoint.safetensors", tmp_path / "dress.glb"
    clip = toy_store.clip("base-test-0").path
    out = call("predict", checkpoint, clip, "-o", target)
    assert re.search(r"13 joints, 90 frames", out)
    assert target.read_bytes()[:4] == b"glTF"
