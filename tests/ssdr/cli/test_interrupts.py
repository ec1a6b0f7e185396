"""Signals: the best model so far is saved, and the exit code is 130."""

from __future__ import annotations

import json
import os
import signal
import sys

import pytest

import ssdr
from helpers.command import faked, start, wait_for

SIGNALS = [n for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n)]


@pytest.mark.parametrize("name", SIGNALS)
def test_a_signal_saves_the_best_model_to_the_outputs(name, clip, tmp_path):
    outputs = tmp_path / "a.npz", tmp_path / "b.glb"
    line = ("decompose", clip, "-o", outputs[0], "-o", outputs[1], "--bones", 2, "--json")
    process = start([*faked(100_000), *line, "-o", tmp_path / "a.png"])
    wait_for(process, "solving")
    process.send_signal(getattr(signal, name))
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    document = json.loads(out)
    assert document["stop_reason"] == "cancelled"
    assert [o["path"] for o in document["outputs"]] == list(map(str, outputs))
    assert all(ssdr.load_skinning(path).n_bones == 2 for path in outputs)
    assert err.splitlines()[-1].startswith("ssdr: interrupted; the best model so far is saved")


def test_a_second_signal_ends_at_once(clip, tmp_path):
    process = start([*faked(9, 60), "decompose", clip, "-o", tmp_path / "a.npz", "--bones", 2])
    wait_for(process, "solving")
    process.send_signal(signal.SIGINT)
    wait_for(process, "again to end")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=20)
    assert process.returncode == 130
    assert [p.name for p in tmp_path.iterdir()] == ["clip.npz"]


@pytest.mark.skipif("SIGHUP" not in SIGNALS, reason="no such signal here")
def test_a_terminal_that_is_closed(clip, tmp_path):
    """It sends its signal twice, as shells and kernels do, and takes no message."""
    out = tmp_path / "a.npz"
    process = start([*faked(100_000), "decompose", clip, "-o", out, "-b", 2])
    wait_for(process, "solving")
    process.stderr.close()
    process.send_signal(signal.SIGHUP)
    process.send_signal(signal.SIGHUP)
    assert process.wait(timeout=60) == 130
    process.stdout.close()
    assert ssdr.load_skinning(out).n_bones == 2


@pytest.mark.skipif("SIGHUP" not in SIGNALS, reason="no such signal here")
def test_an_ignored_signal_stays_ignored(clip, tmp_path):
    """``nohup ssdr ...`` goes on when the terminal is closed."""
    out = tmp_path / "a.npz"
    words = [sys.executable, *faked(20), "decompose", clip, "-o", out, "-b", 2]
    process = start(["-c", _IGNORING, *words])
    wait_for(process, "solving")
    process.send_signal(signal.SIGHUP)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert out.exists()


_IGNORING = (
    "import os, signal, sys; signal.signal(signal.SIGHUP, signal.SIG_IGN); "
    "signal.signal(signal.SIGINT, signal.SIG_IGN); os.execv(sys.argv[1], sys.argv[1:])"
)


@pytest.mark.parametrize(
    "command", [["-m", "ssdr"], ["-c", "import sys; from ssdr.cli import main; sys.exit(main())"]]
)
def test_ctrl_c_during_imports_is_a_line(command, tmp_path):
    (tmp_path / "typer.py").write_text(
        "import sys, time\nsys.stderr.write('importing\\n')\nsys.stderr.flush()\ntime.sleep(60)\n"
    )
    process = start(["-c", _FIRST, str(tmp_path), *command, "info", "a.npz"])
    wait_for(process, "importing")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (130, "ssdr: interrupted\n")


_FIRST = (
    "import os, sys; os.environ['PYTHONPATH'] = sys.argv[1] + os.pathsep + "
    "os.environ['PYTHONPATH']; os.execv(sys.executable, [sys.executable, *sys.argv[2:]])"
)


@pytest.mark.parametrize("name", SIGNALS)
def test_a_signal_while_loading_is_a_line(name, tmp_path, clip):
    code = (
        "import sys, time, ssdr.io, ssdr.cli\n"
        "def load(*a, **k):\n"
        "    sys.stderr.write('loading\\n'); sys.stderr.flush(); time.sleep(60)\n"
        "ssdr.io.load = load\n"
        "sys.exit(ssdr.cli.main())\n"
    )
    process = start(["-c", code, "decompose", clip, "-o", tmp_path / "b.npz", "-b", 2])
    wait_for(process, "loading")
    process.send_signal(getattr(signal, name))
    _, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (130, "ssdr: interrupted\n")


@pytest.mark.slow
def test_the_solver_is_interrupted_and_goes_on(tmp_path):
    """The whole way on the sample: progress on a terminal, Ctrl-C, the model, going on."""
    out = tmp_path / "a.npz"
    line = ["decompose", "sample:dancer_small", "-o", out, "-b", 12, "--json"]
    code = (
        "import sys, ssdr, ssdr.cli\n"
        "solve = ssdr.decompose\n"
        "def decompose(*a, callback, **k):\n"
        "    def follow(progress):\n"
        "        if progress.rmse < 1: sys.stderr.write('solving\\n'); sys.stderr.flush()\n"
        "        return callback(progress)\n"
        "    return solve(*a, callback=follow, **k)\n"
        "ssdr.decompose = decompose\n"
        "sys.exit(ssdr.cli.main())\n"
    )
    process = start(["-c", code, *line, "--effort", "best"])
    wait_for(process, "solving")
    process.send_signal(signal.SIGINT)
    text, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    before = json.loads(text)
    assert before["stop_reason"] == "cancelled"
    more = ("--start", out, "--time-limit", 2)
    process = start(["-m", "ssdr", *line, *more])
    text, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    assert json.loads(text)["rmse"] <= before["rmse"] * (1 + 1e-6)


def test_signals_are_handled_in_the_block_alone():
    from ssdr.signals import interrupt_on_signals, stop_on_signals

    before = [signal.getsignal(getattr(signal, name)) for name in SIGNALS]
    with stop_on_signals() as stop:
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop.is_set()
    with pytest.raises(KeyboardInterrupt), interrupt_on_signals():
        os.kill(os.getpid(), signal.SIGTERM)
    assert [signal.getsignal(getattr(signal, name)) for name in SIGNALS] == before
