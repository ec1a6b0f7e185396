"""Data sets: interrupted runs, one writer, motion capture."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.garment.scenes.dataset import make_data_set
from benchmarks.garment.scenes.scene_file import load_data_set
from garmentnet.data.store import ClipStore
from ssdr.common.errors import InputError

FILE = """
perturbation = 1e-3
[garment]
vertices = 300
[solver]
substeps = 10
approach = 2
settle = 3
[motions]
train = 3
test = 1
frames = 12
"""


HELD = """
import itertools, sys, threading
from benchmarks.garment.scenes import dataset
from benchmarks.garment.simulate import main
add, number = dataset._add, itertools.count()
def held(*arguments):
    if next(number) == 2:  # one clip is whole, the other may be
        print(flush=True)
        threading.Event().wait()
    add(*arguments)
dataset._add = held
main()
"""


def content(path: Path) -> dict[str, bytes]:
    # But for the list of clips, whose order is that of the writing.
    files = (p for p in sorted(path.rglob("*.*")) if p.suffix != ".txt" and p.is_file())
    return {str(p.relative_to(path)): p.read_bytes() for p in files}


def test_killed_and_started_again(tmp_path: Path) -> None:
    source = tmp_path / "few.toml"
    source.write_text(FILE)
    data_set = load_data_set(source)
    names = {s.name for s in data_set.scenes()}
    assert len(names) == 5
    whole = make_data_set(data_set, tmp_path / "whole.clips", workers=1)
    assert set(whole.names(accepted=None, perturbed=None)) == names
    target = tmp_path / "killed.clips"
    command = [sys.executable, "-c", HELD, str(source), "-o", str(target)]
    root = str(Path(__file__).parents[4])
    process = subprocess.Popen(
        [*command, "--workers", "2"],
        env={**os.environ, "PYTHONPATH": root},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    with process:
        assert process.stdout is not None
        held = next((line for line in process.stdout if not line.strip()), None)
        process.kill()
    assert held is not None
    half = ClipStore.open(target).names(accepted=None, perturbed=None)
    assert 0 < len(half) < 5
    before = {n: (target / "clips" / f"{n}.npz").stat().st_mtime_ns for n in half}
    seen = []
    again = make_data_set(data_set, target, workers=1, progress=lambda text, _: seen.append(text))
    assert len(seen) == 5 - len(half)
    assert not any(f"simulated {name}," in text for name in half for text in seen)
    after = {n: (target / "clips" / f"{n}.npz").stat().st_mtime_ns for n in half}
    assert before == after
    assert set(again.names(accepted=None, perturbed=None)) == names
    assert content(target) == content(tmp_path / "whole.clips")
    # Nothing to do: nothing is done.
    seen.clear()
    make_data_set(data_set, target, progress=lambda text, _: seen.append(text))
    assert seen == []
    # The same names from another scene are not taken for the same clips.
    source.write_text(FILE.replace("substeps = 10", "substeps = 20"))
    with pytest.raises(InputError, match="solver"):
        make_data_set(load_data_set(source), target)
    source.write_text(FILE.replace("vertices = 300", "vertices = 350"))
    with pytest.raises(InputError, match="this garment"):
        make_data_set(load_data_set(source), target)


def test_one_writer_at_a_time(tmp_path: Path) -> None:
    (tmp_path / "few.toml").write_text(FILE)
    data_set = load_data_set(tmp_path / "few.toml")
    path = tmp_path / "a.clips"
    make_data_set(data_set, path)
    code = "import filelock, sys; lock = filelock.FileLock(sys.argv[1]); lock.acquire();"
    code += "print(flush=True); input()"
    other = subprocess.Popen(
        [sys.executable, "-c", code, str(path / "writing.lock")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with other:
        assert other.stdout is not None
        other.stdout.readline()
        with pytest.raises(InputError, match="nobody writes"):
            make_data_set(data_set, path)
        other.kill()
    make_data_set(data_set, path)
