# ruff: noqa: E402
"""The demo: the garment that ships; and simulate, decompose, train, evaluate, draw."""

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from PIL import Image

from garmentnet.cli import demo, main


@pytest.mark.slow
def test_the_dress_that_ships_dances(tmp_path, capsys):
    assert main(["demo", "-o", str(tmp_path)]) == 0
    sheet, vertices, film, _ = map(Path, capsys.readouterr().out.splitlines())
    with Image.open(sheet) as picture:
        assert len(picture.getcolors(1 << 24)) > 4096
    with np.load(vertices) as archive:
        moved = archive["vertices"]
    assert moved.shape == (120, 2100, 3)
    size = np.ptp(moved, axis=1)
    assert ((size > 0.3) & (size < 1.5)).all()  # a dress in every frame
    assert np.ptp(size, axis=0).max() > 0.1  # that swings
    assert film.stat().st_size > 20_000


@pytest.mark.slow
def test_an_interrupted_demo_continues_and_gives_scores_and_pictures(tmp_path):
    def stop(step, fraction):
        if step.startswith("low 5,"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        demo.run_pipeline(tmp_path / "demo", progress=stop)
    steps = []
    files = demo.run_pipeline(tmp_path / "demo", progress=lambda step, *_: steps.append(step))
    assert not any(step.startswith("simulated") for step in steps)
    assert not any(step.startswith("low 1,") for step in steps)
    report, sheet, film, checkpoint = files
    rows = [[x.strip() for x in line.split("|")] for line in report.read_text("utf-8").splitlines()]
    begin = next(k for k, row in enumerate(rows) if row[1:2] == ["all vertices"])
    column = rows[begin].index("overall RMSE")
    overall = {row[1]: float(row[column]) for row in rows[begin + 2 : rows.index([""], begin)]}
    assert overall["run-checkpoint"] < overall["mean shape"]
    assert "ridge" in overall
    assert checkpoint.is_file()
    with Image.open(sheet) as picture, Image.open(film) as frames:
        assert len(picture.getcolors(1 << 24)) > 4096
        assert frames.n_frames == 90
