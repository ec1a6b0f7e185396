# ruff: noqa: E402
"""The whole pipeline on the data set `tiny`: simulate, decompose, train, evaluate, draw."""

from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from garmentnet.cli.demo import run_demo


@pytest.mark.slow
def test_demo(tmp_path):
    summary = run_demo(tmp_path)
    assert all(Path(file).is_file() for file in summary["files"])
    scores = {line.split("|")[0].strip(): line.split("|") for line in summary["table"][2:]}
    overall = {name: float(cells[3].split()[0]) for name, cells in scores.items()}
    assert overall["network"] < overall["mean shape"]
