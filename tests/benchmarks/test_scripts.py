"""Every script says how it is used, and measures its smallest case."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import common
from benchmarks.speed.long_sequences import true_error
from benchmarks.speed.skirt import BLOCK, Skirt

FOLDER = common.ROOT / "benchmarks"
SCRIPTS = [
    path.relative_to(FOLDER).as_posix()
    for path in sorted(FOLDER.rglob("*.py"))
    if "__main__" in path.read_text("utf-8")
]


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_says_how_it_is_used(
    script: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if script.startswith("garment"):
        pytest.importorskip("torch")
    monkeypatch.setattr(sys, "argv", [script, "--help"])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(FOLDER / script), run_name="__main__")
    assert end.value.code == 0
    assert "usage: " in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "case", "key"),
    [
        ("accuracy/parsimony.py", "static mesh", "error / tolerance"),
        ("interchange/programs.py", "tube.glb in ssdr", "vertices"),
        ("speed/first_call.py", "import ssdr", "process"),
    ],
)
def test_a_script_measures_and_keeps(script: str, case: str, key: str, tmp_path: Path) -> None:
    out = tmp_path / "rows.json"
    options = ["--only", case, "--out", str(out)]
    command = [sys.executable, str(FOLDER / script), *options]
    # the second finds the row and measures nothing
    for _ in range(1 + (script == "speed/first_call.py")):
        done = subprocess.run(command, capture_output=True, text=True, timeout=600)
        assert done.returncode == 0, done.stderr
        record = common.Record(out)
        (row,) = record.rows.values()
        assert key in row
        assert record.machine["gemm_1"] > 0
    assert "| case |" in done.stdout


def test_a_skirt_is_written_in_pieces_and_far_from_its_skinning_by_the_floor(
    tmp_path: Path,
) -> None:
    skirt, path = Skirt(vertices=60, columns=4, influences=2), tmp_path / "skirt.npy"
    first = skirt.write(path, BLOCK, 2 * BLOCK)
    floor = skirt.write(path, 2 * BLOCK, 2 * BLOCK)
    frames = np.load(path)
    np.testing.assert_array_equal(frames[BLOCK:], skirt.block(BLOCK, BLOCK)[0])
    true = common.reskin(
        skirt.rest, skirt.indices, skirt.weights, skirt.transforms(np.arange(2 * BLOCK))
    )
    assert np.sqrt(((frames - true) ** 2).sum(axis=2).mean()) == pytest.approx(floor, rel=1e-5)
    assert first == pytest.approx(floor, rel=0.2)

    class Model:
        rest, indices, weights = skirt.rest, skirt.indices, skirt.weights
        transforms = skirt.transforms(np.arange(2 * BLOCK))

    assert true_error(frames, Model, range(2 * BLOCK)) == pytest.approx(floor, rel=1e-5)
