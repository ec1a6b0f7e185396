"""Signals: the best model so far is saved, and the exit code is 130."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from pathlib import Path

import pytest

import ssdr
from helpers.command import fake_decompose, faked, start, wait_for

SIGNALS = [n for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n)]


def send(*names):
    for name in names:
        os.kill(os.getpid(), getattr(signal, name))


@pytest.fixture
def interrupted(monkeypatch):
    """A solver that gets signals before it tells its first step; handlers are put back.

    Tests that run in the background or under nohup have signals ignored; the command has not.
    """
    before = {n: signal.signal(getattr(signal, n), signal.default_int_handler) for n in SIGNALS}

    def install(*names):
        def decompose(sequence, *, callback, **options):
            def follow(progress):
                send(*names)
                return callback(progress)

            return fake_decompose(sequence, callback=follow, **options)

        monkeypatch.setitem(vars(ssdr), "decompose", decompose)

    yield install
    for name, handler in before.items():
        signal.signal(getattr(signal, name), handler)


@pytest.mark.parametrize("names", [["SIGINT"], ["SIGTERM"], ["SIGHUP"] * 2], ids=str)
def test_a_signal_saves_the_best_model_to_the_outputs(names, interrupted, run, clip, tmp_path):
    """A terminal that is closed sends its signal twice, as shells and kernels do."""
    if names[0] not in SIGNALS:
        pytest.skip("no such signal here")
    interrupted(*names)
    outputs = tmp_path / "a.npz", tmp_path / "b.glb"
    line = ("decompose", clip, "-o", outputs[0], "-o", outputs[1], "--bones", 2, "--json")
    code, out, err = run(*line, "-o", tmp_path / "a.png")
    assert code == 130, err
    document = json.loads(out)
    assert document["stop_reason"] == "cancelled"
    assert [o["path"] for o in document["outputs"]] == list(map(str, outputs))
    assert all(ssdr.load_skinning(path).n_bones == 2 for path in outputs)
    assert err.splitlines()[-1].startswith("ssdr: interrupted; the best model so far is saved")


def test_an_ignored_signal_stays_ignored(interrupted, run, clip, tmp_path):
    """``nohup ssdr ...`` goes on when the terminal is closed."""
    for name in SIGNALS:
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    interrupted(*SIGNALS)
    code, _, err = run("decompose", clip, "-o", tmp_path / "a.npz", "-b", 2)
    assert code == 0, err
    assert (tmp_path / "a.npz").exists()


@pytest.mark.parametrize("name", SIGNALS)
def test_a_signal_while_loading_is_a_line(name, interrupted, run, tmp_path, clip, monkeypatch):
    def load(*_, **__):
        send(name)
        threading.Event().wait()

    monkeypatch.setattr("ssdr.cli.solve_commands.load_clips", load)
    found = run("decompose", clip, "-o", tmp_path / "b.npz", "-b", 2)
    assert found == (130, "", "ssdr: interrupted\n")


def test_signals_are_handled_in_the_block_alone():
    from ssdr.common.signals import interrupt_on_signals, stop_on_signals

    before = [signal.getsignal(getattr(signal, name)) for name in SIGNALS]
    with stop_on_signals() as stop:
        send("SIGTERM")
        assert stop.is_set()
    with pytest.raises(KeyboardInterrupt), interrupt_on_signals():
        send("SIGTERM")
    assert [signal.getsignal(getattr(signal, name)) for name in SIGNALS] == before


def test_ctrl_c_while_a_package_is_imported_counts_after_it(tmp_path, monkeypatch):
    """Native modules swallow it, or fail with another error."""
    from ssdr.io.optional import import_optional

    code = (
        "import signal\ntry:\n    signal.raise_signal(signal.SIGINT)\nexcept KeyboardInterrupt:\n"
    )
    (tmp_path / "swallows.py").write_text(code + "    pass\nwhole = True\n")
    monkeypatch.syspath_prepend(tmp_path)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background
    try:
        with pytest.raises(KeyboardInterrupt):
            import_optional("swallows", "swallows", "a test")
    finally:
        signal.signal(signal.SIGINT, before)
    assert sys.modules["swallows"].whole
    monkeypatch.delitem(sys.modules, "swallows")


def test_ctrl_c_during_imports_is_a_line(tmp_path):
    (tmp_path / "typer.py").write_text(
        "import sys, threading\nsys.stderr.write('importing\\n')\nsys.stderr.flush()\n"
        "threading.Event().wait()\n"
    )
    process = start(["-c", _FIRST, str(tmp_path), "-m", "ssdr.cli", "info", "a.npz"])
    wait_for(process, "importing")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=600)
    assert (process.returncode, err) == (130, "ssdr: interrupted\n")


_FIRST = (
    "import os, sys; os.environ['PYTHONPATH'] = sys.argv[1] + os.pathsep + "
    "os.environ['PYTHONPATH']; os.execv(sys.executable, [sys.executable, *sys.argv[2:]])"
)


def until_taken(process):
    """Wait until no signal is pending, where the system says so."""
    status = Path(f"/proc/{process.pid}/status")
    while status.exists():
        lines = [line.split() for line in status.read_text().splitlines()]
        if not any(int(line[1], 16) for line in lines if line[0] in ("SigPnd:", "ShdPnd:")):
            return


@pytest.mark.parametrize("names", [["SIGINT", "SIGTERM"], ["SIGTERM"] * 2, ["SIGHUP", "SIGTERM"]])
@pytest.mark.skipif("SIGHUP" not in SIGNALS, reason="no such signals here")
@pytest.mark.slow
def test_a_second_signal_ends_code_that_never_returns_to_python(names, tmp_path, clip):
    """As when another library's function that reads a file does not end."""
    code = (
        "import hashlib, sys, threading, ssdr.cli.solve_commands, ssdr.cli\n"
        "go = threading.Event()\n"
        "def tell():\n"
        "    go.wait(); sys.stderr.write('loading\\n'); sys.stderr.flush()\n"
        "def load(*a, **k):\n"
        "    threading.Thread(target=tell, daemon=True).start()\n"
        "    sys.setswitchinterval(1e4); go.set()  # nobody is told before the next call\n"
        "    hashlib.pbkdf2_hmac('sha256', b'', b'', 10**9)\n"
        "ssdr.cli.solve_commands.load_clips = load\n"
        "sys.exit(ssdr.cli.main())\n"
    )
    process = start(["-c", code, "decompose", clip, "-o", tmp_path / "b.npz", "-b", 2])
    try:
        wait_for(process, "loading")
        for name in names:
            process.send_signal(getattr(signal, name))
            until_taken(process)  # two of one kind at once are one
        _, err = process.communicate(timeout=600)
    finally:
        process.kill()
    assert (process.returncode, err) == (130, "\nssdr: interrupted\n")


@pytest.mark.slow
def test_a_second_signal_ends_at_once(clip, tmp_path):
    process = start([*faked(9, 60), "decompose", clip, "-o", tmp_path / "a.npz", "--bones", 2])
    wait_for(process, "solving")
    process.send_signal(signal.SIGINT)
    wait_for(process, "again to end")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=600)
    assert process.returncode == 130
    assert [p.name for p in tmp_path.iterdir()] == ["clip.npz"]
