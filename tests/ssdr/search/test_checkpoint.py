"""Checkpoints: the best model so far in an ordinary file, whatever happens to the run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.disks import small_files
from helpers.measures import frames, rig, rmse_of
from ssdr.io.arrays import npz
from ssdr.search import progress

ROOT = Path(__file__).parents[3]


@pytest.fixture
def always(monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkpoint after every step."""
    monkeypatch.setattr(progress, "_SECONDS", 0.0)


def assert_same(a: ssdr.Skinning, b: ssdr.Skinning) -> None:
    for name in ("rest", "indices", "weights", "transforms", "faces", "parents"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert a.clips == b.clips


def assert_goes_on(path: Path, array: np.ndarray, **options: Any) -> None:
    """Taken up, a run ends no higher; on all frames, if the model is of some of them."""
    model = ssdr.load_skinning(path)
    whole = model.n_frames == len(array)
    before = rmse_of(model, array) if whole else ssdr.fit_bones(array, model).rmse
    after = ssdr.decompose(array, start=model, effort="fast", **options)
    assert after.rmse <= before * (1 + 1e-12)


@pytest.mark.usefixtures("always")
@pytest.mark.parametrize("joints", [None, pytest.param("rigid", marks=pytest.mark.slow)])
def test_a_checkpoint_is_the_best_model_so_far(tmp_path: Path, joints: str | None) -> None:
    path, seen = tmp_path / "model.npz", []

    def watch(state: ssdr.search.progress.Progress) -> None:
        if not np.isfinite(state.rmse):
            assert not path.exists()
            return
        seen.append(rmse_of(ssdr.load_skinning(path), frames()))
        if joints == "rigid":  # joints away from the skin count as error
            assert seen[-1] <= 1.01 * state.rmse
        else:
            assert seen[-1] == pytest.approx(state.rmse, rel=0.01)
        assert list(tmp_path.iterdir()) == [path]

    sequence = ssdr.MeshSequence(frames(), rig().faces, 30, name="walk")
    options = {"bones": 4, "rig": joints, "effort": "fast"}
    result = ssdr.decompose(sequence, **options, checkpoint=path, callback=watch)
    assert len(seen) > 10
    model = ssdr.load_skinning(path)
    assert_same(model, result.skinning)
    assert (model.parents is None) == (joints is None)
    assert_goes_on(path, frames(), rig=joints)


def test_a_checkpoint_is_written_every_minute_and_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, steps, written = 1000.0, 0, []
    write = npz.write_skinning

    def counted(*arguments: Any, **options: Any) -> object:
        written.append(steps)
        return write(*arguments, **options)

    def tick(state: ssdr.search.progress.Progress) -> None:
        nonlocal now, steps
        now += 7.0
        steps += 1

    monkeypatch.setattr(npz, "write_skinning", counted)
    monkeypatch.setattr(progress.time, "monotonic", lambda: now)
    # a str will do
    where = str(tmp_path / "model.npz")
    ssdr.decompose(frames(), bones=4, effort="fast", checkpoint=where, callback=tick)
    assert written == [*range(9, steps, 9), steps]  # the first step that is 60 s after the last
    assert steps > 18


@pytest.mark.usefixtures("always", "tiny_memory")
def test_while_frames_are_streamed_it_is_a_model_of_those_that_were_read(tmp_path: Path) -> None:
    array, path, lengths = motions.rippled(), tmp_path / "model.npz", []

    def watch(state: ssdr.search.progress.Progress) -> None:
        if path.exists() and (not lengths or state.phase == "all frames"):
            lengths.append(ssdr.load_skinning(path).n_frames)
            assert_goes_on(path, array)

    result = ssdr.decompose(array, bones=4, effort="fast", checkpoint=path, callback=watch)
    assert lengths == sorted(lengths)
    assert 40 <= lengths[0] <= lengths[-1] < 90
    assert ssdr.load_skinning(path).n_frames == 120
    assert_same(ssdr.load_skinning(path), result.skinning)


@pytest.mark.usefixtures("always")
def test_a_full_disk_leaves_the_last_model_whole_and_does_not_end_the_run(tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    first = ssdr.decompose(frames(), bones=3, effort="fast", checkpoint=path)
    options = {"bones": 4, "effort": "fast"}
    with small_files(5000), pytest.warns(ssdr.SsdrWarning, match="no checkpoint at"):
        second = ssdr.decompose(frames(), **options, checkpoint=path)
    assert_same(ssdr.load_skinning(path), first.skinning)
    assert list(tmp_path.iterdir()) == [path]
    assert second.rmse == ssdr.decompose(frames(), **options).rmse


KILLED = """
import os, signal, sys
import ssdr
from helpers import motions
from ssdr.search import progress, scan
progress._SECONDS = 0.0
if sys.argv[2] == "streamed":
    scan._IN_MEMORY, scan._FEWEST, scan._MOST, scan._MOST_SPREAD = 1, 40, 40, 80
left = int(sys.argv[3])
def moment(*_):
    global left
    left -= 1
    if not left:
        os.kill(os.getpid(), signal.SIGKILL)
def heard(event, arguments):
    if event in ("open", "os.rename", "os.remove", "os.chmod"):
        moment()
ssdr.decompose(motions.rippled(), bones=4, effort="fast", checkpoint=sys.argv[1])
sys.addaudithook(heard)
for seed in range(99):
    ssdr.decompose(motions.rippled(), bones=4, rng=seed, checkpoint=sys.argv[1], callback=moment)
"""


@pytest.mark.parametrize("way", ["in memory", "streamed"])
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
def test_killed_at_any_moment_a_run_goes_on_from_its_checkpoint(
    seed: int, way: str, tmp_path: Path
) -> None:
    """By SIGKILL, between two steps or two calls of the system that write a checkpoint."""
    rng = np.random.default_rng([seed, len(way)])
    path = tmp_path / "model.npz"
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(path), way, str(rng.integers(1, 600))],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests")])},
        check=False,
    )
    assert done.returncode == -signal.SIGKILL
    assert_goes_on(path, motions.rippled())
