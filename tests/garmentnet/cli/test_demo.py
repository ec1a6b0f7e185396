# ruff: noqa: E402
"""The demo on fewer and shorter clips: simulate, decompose, train, evaluate, draw."""

import importlib.util
from importlib import resources
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from PIL import Image

from garmentnet.cli import demo
from garmentnet.configs import load_config, override


@pytest.fixture
def shorter(tmp_path, monkeypatch):
    """The data set ``tiny`` with a third of its clips and no other parameters, and few epochs."""
    from garmentnet.scenes import scene_file

    text = resources.files("garmentnet.scenes").joinpath("presets/tiny.toml").read_text()
    text = text.partition("[[set]]")[0]
    for line, less in (
        ("train = 12 ", "train = 4 "),
        ("frames = 90", "frames = 60"),
        ("vertices = 500", "vertices = 300"),
        ("substeps = 30", "substeps = 20"),
    ):
        assert line.strip() in text
        text = text.replace(line.strip(), less.strip())
    (tmp_path / "short.toml").write_text(text)
    short = scene_file.load_data_set(tmp_path / "short.toml")
    config = override(load_config("tiny"), ["train.epochs=30", "train.high_epochs=4"])
    monkeypatch.setattr(scene_file, "load_data_set", lambda name: short)
    monkeypatch.setattr(demo, "load_config", lambda name: config)


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("newton") is None, reason="needs the extra scenes (newton, warp)"
)
@pytest.mark.usefixtures("shorter")
def test_an_interrupted_demo_continues_and_gives_scores_and_pictures(tmp_path):
    def stop(step, fraction, left):
        if step.startswith("training low, epoch 5"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        demo.run_demo(tmp_path / "demo", progress=stop)
    steps = []
    summary = demo.run_demo(tmp_path / "demo", progress=lambda step, *_: steps.append(step))
    assert not any(step.startswith("simulating, 0") for step in steps)
    assert not any(step == "training low, epoch 1" for step in steps)
    scores = {line.split("|")[0].strip(): line.split("|") for line in summary["table"][2:]}
    overall = {name: float(cells[3].split()[0]) for name, cells in scores.items()}
    assert overall["network"] < overall["mean shape"]
    sheet, film, checkpoint = map(Path, summary["files"])
    assert checkpoint.is_file()
    with Image.open(sheet) as picture, Image.open(film) as frames:
        assert len(picture.getcolors(1 << 24)) > 4096
        assert frames.n_frames == 60
