"""Signals and full disks: the state outlives them, and the command says where it is."""

from __future__ import annotations

import errno
import json
import os
import shlex
import signal
import sys
from types import SimpleNamespace

import pytest

import ssdr
from helpers.command import FAKED, FakeState, fake_decompose, start, wait_for
from helpers.disks import fill
from ssdr.cli.interruption import save_somewhere, state_beside
from ssdr.io.atomic import write_bytes


class SavedState(FakeState):
    """One that is written as the real one is."""

    def save(self, path):
        write_bytes(path, b"%d steps" % self.steps)


@pytest.fixture
def saved(faked, monkeypatch):
    def decompose(*args, **kwargs):
        result = fake_decompose(*args, **kwargs)
        return SimpleNamespace(**vars(result) | {"state": SavedState(result.state.steps)})

    monkeypatch.setitem(vars(ssdr), "decompose", decompose)


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Working folder, temporary folder and home, apart from the output's."""
    made = [tmp_path / name for name in ("full", "working", "temporary", "home")]
    for folder in made:
        folder.mkdir()
    monkeypatch.chdir(made[1])
    monkeypatch.setattr("tempfile.tempdir", str(made[2]))
    monkeypatch.setenv("HOME", str(made[3]))
    return made


def test_a_full_disk_sends_the_state_to_another_folder(saved, run, clip, folders, monkeypatch):
    """It went to the same full disk, and the work was lost without a word."""
    full, working, temporary, home = folders
    out = full / "a.npz"
    fill(full, monkeypatch)
    code, _, err = run("decompose", clip, "-b", 2, "-o", out, "-q")
    assert code == 1
    place = working / "a.state.npz"
    assert place.read_bytes() == b"3 steps"
    lines = err.splitlines()
    assert f"{full / 'a.state.npz'}: No space left on device" in lines[0]
    assert f"the state goes to {place} instead" in lines[0]
    command = shlex.split(lines[1].partition("write it with: ")[2])
    assert command[-2:] == ["--resume", str(place)]
    assert lines[2] == f"ssdr: error: {out}: No space left on device"
    assert list(full.iterdir()) == []

    fill(working, monkeypatch)
    code, text, _ = run("decompose", clip, "-b", 2, "-o", out, "--json")
    document = json.loads(text)
    assert (code, document["state"]) == (1, str(temporary / "a.state.npz"))
    assert document["resume"].endswith(document["state"])
    # what is there is somebody's work
    code, text, _ = run("decompose", clip, "-b", 2, "-o", out, "--json")
    other = json.loads(text)["state"]
    assert other != document["state"]
    assert other.startswith(str(temporary))
    assert other.endswith(".npz")
    fill(temporary, monkeypatch)
    fill(home, monkeypatch)
    code, _, err = run("decompose", clip, "-b", 2, "-o", out, "-q")
    assert code == 1
    assert f"the result is lost: {full / 'a.state.npz'}: No space left on device" in err


def test_an_interrupt_with_a_full_disk_loses_nothing(
    saved, run, clip, folders, monkeypatch, request
):
    full, working, *_ = folders
    fill(full, monkeypatch)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    monkeypatch.setattr("ssdr.cli.progress.Reporter.update", lambda *_: os.kill(os.getpid(), 2))
    code, text, _ = run("decompose", clip, "-b", 2, "-o", full / "a.npz", "--json")
    document = json.loads(text)
    assert (code, document["exit_code"]) == (130, 130)
    assert document["state"] == str(working / "a.state.npz")
    assert (working / "a.state.npz").read_bytes() == b"1 steps"


def test_a_working_folder_that_has_gone_is_passed_over(folders, monkeypatch):
    full, working, temporary, _ = folders
    fill(full, monkeypatch)
    working.rmdir()
    place = save_somewhere(SavedState(1), full / "a.state.npz")
    assert place == temporary / "a.state.npz"


def test_the_name_of_the_state_fits(tmp_path):
    long = state_beside(tmp_path / ("ü" * 125 + ".npz"))
    assert len(os.fsencode(long.name)) <= 255
    assert long.name.endswith(".state.npz")
    assert state_beside(tmp_path / "a.glb") == tmp_path / "a.state.npz"


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no such signal here")
def test_a_terminal_that_hangs_up_leaves_a_state(clip, tmp_path):
    """Twice, as shells and kernels do, and with nobody to write to."""
    out = tmp_path / "a.npz"
    process = start(["-c", FAKED.format(steps=100_000), "decompose", clip, "-o", out, "-b", 2])
    wait_for(process, "alternate")
    process.stderr.close()
    process.send_signal(signal.SIGHUP)
    process.send_signal(signal.SIGHUP)
    assert process.wait(timeout=60) == 130
    process.stdout.close()
    assert FakeState.load(tmp_path / "a.state.npz").steps >= 1
    assert not out.exists()


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no such signal here")
def test_an_ignored_signal_stays_ignored(clip, tmp_path):
    """``nohup ssdr ...`` goes on when the terminal is closed."""
    out = tmp_path / "a.npz"
    code = FAKED.format(steps=20)
    process = start(
        ["-c", _IGNORING, sys.executable, "-c", code, "decompose", clip, "-o", out, "-b", 2]
    )
    wait_for(process, "alternate")
    process.send_signal(signal.SIGHUP)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert out.exists()


_IGNORING = (
    "import os, signal, sys; signal.signal(signal.SIGHUP, signal.SIG_IGN); "
    "signal.signal(signal.SIGINT, signal.SIG_IGN); os.execv(sys.argv[1], sys.argv[1:])"
)


@pytest.mark.parametrize("command", [["-m", "ssdr"], ["-c", "from ssdr.cli import main; main()"]])
def test_ctrl_c_during_imports_is_a_line(command, tmp_path):
    """It was a traceback.  An import that waits stands for one that takes long."""
    (tmp_path / "typer.py").write_text(
        "import sys, time\nsys.stderr.write('importing\\n')\nsys.stderr.flush()\ntime.sleep(60)\n"
    )
    process = start(["-c", _FIRST, str(tmp_path), *command, "info", "a.npz"])
    wait_for(process, "importing")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert err == "ssdr: interrupted\n"


_FIRST = (
    "import os, sys; os.environ['PYTHONPATH'] = sys.argv[1] + os.pathsep + "
    "os.environ['PYTHONPATH']; os.execv(sys.executable, [sys.executable, *sys.argv[2:]])"
)


def test_ctrl_c_while_loading_is_a_line(tmp_path, clip):
    code = (
        "import sys, time, ssdr.io.load_save, ssdr.io, ssdr.cli\n"
        "def load(*a, **k):\n"
        "    sys.stderr.write('loading\\n'); sys.stderr.flush(); time.sleep(60)\n"
        "ssdr.io.load_save.load = ssdr.io.load = load\n"
        "sys.exit(ssdr.cli.main())\n"
    )
    process = start(["-c", code, "decompose", clip, "-o", tmp_path / "b.npz", "-b", 2])
    wait_for(process, "loading")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (130, "ssdr: interrupted\n")


def test_without_a_temporary_folder_the_work_is_done(faked, run, clip, tmp_path, monkeypatch):
    """The rehearsal needs one, the work does not."""

    def none(*_, **__):
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found")

    monkeypatch.setattr("tempfile.mkdtemp", none)
    code, _, err = run("decompose", clip, "-b", 2, "-o", tmp_path / "a.npz", "-q")
    assert (code, err) == (0, "")


def test_a_folder_that_goes_during_the_work_sends_the_state_elsewhere(
    saved, run, clip, folders, monkeypatch
):
    full, working, *_ = folders
    monkeypatch.setattr(
        "ssdr.cli.progress.Reporter.update", lambda *_: full.exists() and full.rmdir()
    )
    code, _, err = run("decompose", clip, "-b", 2, "-o", full / "a.npz")
    assert code == 2
    assert (working / "a.state.npz").read_bytes() == b"3 steps"
    assert f"the result is kept in {working / 'a.state.npz'}" in err


def test_the_command_that_goes_on_is_not_refused(saved, run, clip, folders, monkeypatch):
    """What was written before the disk was full is in its way."""
    full, working, *_ = folders
    fill(full, monkeypatch)
    good, state = working / "good.npz", working / "good.state.npz"
    code, _, err = run("decompose", clip, "-b", 2, "-o", good, "-o", full / "a.npz", "-q")
    assert code == 1
    assert good.exists()
    command = shlex.split(err.splitlines()[0].partition("write it with: ")[2])
    assert command[-3:] == ["--resume", str(state), "--force"]
    monkeypatch.undo()
    monkeypatch.setitem(vars(ssdr), "decompose", fake_decompose)
    monkeypatch.setitem(vars(ssdr), "SolverState", SimpleNamespace(load=lambda _: FakeState(3)))
    assert run(*command[1:])[0] == 0
    assert (full / "a.npz").exists()
