# ruff: noqa: E402
"""The demo: simulate, decompose, train, evaluate, draw."""

from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from PIL import Image

from garmentnet.cli import demo


@pytest.mark.slow
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
    names = [cell.strip() for cell in summary["table"][0].split("|")]
    rows = [[cell.strip() for cell in line.split("|")] for line in summary["table"][2:]]
    overall = {row[1]: float(row[names.index("overall RMSE")]) for row in rows}
    assert overall["network"] < overall["mean shape"]
    sheet, film, checkpoint = map(Path, summary["files"])
    assert checkpoint.is_file()
    with Image.open(sheet) as picture, Image.open(film) as frames:
        assert len(picture.getcolors(1 << 24)) > 4096
        assert frames.n_frames == 90
