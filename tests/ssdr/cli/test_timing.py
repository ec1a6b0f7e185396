"""Whoever waits a second is told for what, and a time limit holds for all of it."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import time

import pytest

import ssdr
from helpers.command import fake_decompose
from ssdr.cli import progress, timing
from ssdr.cli.progress import waiting


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def hasty(monkeypatch):
    monkeypatch.setattr(progress, "_PATIENCE", 0.02)
    monkeypatch.setattr(progress, "_EVERY", 0.02)


@pytest.mark.usefixtures("hasty")
def test_a_wait_is_said_and_cleared_on_a_terminal():
    plain, live = io.StringIO(), Terminal()
    for stream in (plain, live):
        with waiting("loading a.abc", show=True, stream=stream):
            time.sleep(0.2)
    assert "loading a.abc, 0 s\n" in plain.getvalue()
    assert live.getvalue().startswith("\rloading a.abc, 0 s")
    assert live.getvalue().endswith("\r\x1b[K")
    silent = io.StringIO()
    with waiting("loading", show=False, stream=silent):
        time.sleep(0.1)
    assert silent.getvalue() == ""


@pytest.mark.usefixtures("hasty")
def test_a_wait_ends_with_what_was_waited_for():
    for closed_first in (True, False):
        stream = io.StringIO()
        if closed_first:
            stream.close()
        with waiting("x", show=True, stream=stream):
            stream.close()
            time.sleep(0.1)
    stream = io.StringIO()

    def fail():
        with waiting("x", show=True, stream=stream):
            time.sleep(0.1)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    said = stream.getvalue()
    time.sleep(0.1)
    assert stream.getvalue() == said != ""


def test_a_short_wait_says_nothing():
    stream = io.StringIO()
    with waiting("loading", show=True, stream=stream):
        pass
    assert stream.getvalue() == ""


@pytest.fixture
def slow(monkeypatch):
    """Files that take a while to load and to save."""
    load, save = ssdr.io.load, ssdr.save

    def slow_load(*args, **options):
        time.sleep(0.3)
        return load(*args, **options)

    def slow_save(*args, **options):
        time.sleep(0.3)
        return save(*args, **options)

    monkeypatch.setattr("ssdr.io.load", slow_load)
    monkeypatch.setattr("ssdr.io.save", slow_save)  # that of rehearsals
    monkeypatch.setitem(vars(ssdr), "save", slow_save)


@pytest.mark.usefixtures("faked", "slow", "hasty")
def test_progress_of_loading_and_saving(run, clip, tmp_path):
    code, out, err = run("decompose", clip, "-b", 2, "-o", tmp_path / "out.npz")
    assert code == 0, err
    assert f"loading {clip}, " in err
    assert f"saving {tmp_path / 'out.npz'}, " in err
    row = next(line for line in out.splitlines() if line.startswith("time"))
    assert "loading 0.3 s" in row
    assert "saving 0.3 s" in row
    code, _, err = run("convert", clip, tmp_path / "b.npz")
    assert code == 0
    assert f"saving {tmp_path / 'b.npz'}, " in err
    code, _, err = run("convert", clip, tmp_path / "c.npz", "--quiet")
    assert (code, err) == (0, "")


@pytest.mark.usefixtures("faked", "slow")
def test_the_time_limit_is_for_loading_and_saving_too(run, clip, tmp_path):
    arguments = ("decompose", clip, "-b", 2, "-o", tmp_path / "out.npz", "--json")
    code, out, err = run(*arguments, "--time-limit", 20)
    assert code == 0, err
    # 0.3 s of loading and 3 rehearsals of 0.3 s are over, 0.3 s of saving are to come
    left = fake_decompose.options["time_limit"]
    assert 0 < left < 20 - 1.5 + 0.01
    found = json.loads(out)
    assert found["load_seconds"] >= 0.3
    assert found["save_seconds"] >= 0.3
    assert found["total_seconds"] >= found["load_seconds"] + found["save_seconds"]
    code, _, err = run(*arguments, "--time-limit", 0.1, "--force")
    assert code == 0, err
    assert fake_decompose.options["time_limit"] == pytest.approx(0.005)  # one model in any case
    code, _, err = run(*arguments, "--force")
    assert code == 0, err
    assert fake_decompose.options["time_limit"] is None


def test_the_time_of_saving_grows_with_the_frames(wave, tmp_path, monkeypatch):
    monkeypatch.setattr(timing, "rehearse", lambda *_, stored, **__: time.sleep(0.02 * stored))
    options = {"frames": 100, "bones": 3}
    found = timing._seconds_to_save(wave, tmp_path / "a.npz", {}, **options)
    assert found == pytest.approx(2.0, rel=0.2)
    assert timing._seconds_to_save(wave, tmp_path / "a.fbx", {}, **options) >= 10


def test_the_picture_gets_as_many_frames_as_there_is_time_for():
    now = time.perf_counter()
    assert timing.frames_of_sheet(None, now - 1000, 1.0) == 5
    assert timing.frames_of_sheet(20, now - 1, 0.1) == 5
    assert timing.frames_of_sheet(20, now - 10, 0.5) == 3
    assert timing.frames_of_sheet(20, now - 30, 0.5) == 1


@pytest.mark.usefixtures("faked")
def test_a_slow_picture_leaves_the_solver_its_time(run, clip, tmp_path, monkeypatch):
    monkeypatch.setattr(timing, "_seconds_of_panel", lambda _: 10.0)
    out, picture = tmp_path / "out.npz", tmp_path / "p.png"
    line = ("decompose", clip, "-b", 2, "-o", out, "--picture", picture, "--time-limit", 20)
    code, _, err = run(*line)
    assert code == 0, err
    assert 10 < fake_decompose.options["time_limit"] < 15


def test_the_start_of_the_process_counts_for_the_time_limit():
    program = (
        "import time; began = time.perf_counter(); time.sleep(0.3); "
        "from ssdr.cli.timing import seconds_running; "
        "print(seconds_running(), time.perf_counter() - began)"
    )
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    running, measured = map(float, told.stdout.split())
    assert running > measured if sys.platform == "linux" else running > 0
    assert running < measured + 30
