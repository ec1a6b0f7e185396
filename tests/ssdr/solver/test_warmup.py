"""Kernels are ready before the clock starts, whatever happens to the second process."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ssdr
from ssdr import parallel
from ssdr.kernels import bones, lbs, polish, schur, vertices
from ssdr.solver import warmup

_REPORT = """
import json, sys
from numba.core import event

class Names(event.Listener):
    found = []
    def on_start(self, e):
        self.found.append(e.data["dispatcher"].__name__)
    def on_end(self, e):
        pass

names = Names()
with event.install_listener("numba:compile", names):
    from ssdr.solver import warmup
    seconds = warmup.compile_kernels()
print(json.dumps({"compiled": names.found, "seconds": seconds}))
"""


two_cores = pytest.mark.skipif(
    len(getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))(0)) < 2,
    reason="one core: kernels are compiled by one process",
)


@pytest.fixture
def threads():
    ssdr.set_threads(2)
    yield
    ssdr.set_threads(None)


@pytest.fixture
def python(monkeypatch: pytest.MonkeyPatch, threads: None) -> None:
    """As in a main process on two cores, wherever the test itself runs."""
    monkeypatch.setattr(warmup.multiprocessing, "parent_process", lambda: None)
    monkeypatch.setattr(warmup.os, "sched_getaffinity", lambda _: {0, 1}, raising=False)


def signatures() -> dict[str, int]:
    modules = (bones, lbs, polish, schur, vertices)
    return {
        f"{m.__name__}.{name}": len(value.signatures)
        for m in modules
        for name, value in vars(m).items()
        if hasattr(value, "signatures")
    }


@pytest.mark.parametrize("effort", ["fast", "balanced"])
def test_nothing_is_left_to_compile(effort: str, rng: np.random.Generator) -> None:
    warmup.compile_kernels()
    before = signatures()
    assert before["ssdr.kernels.polish.polish_vertices"] >= 1
    ssdr.decompose(rng.standard_normal((5, 40, 3)), bones=4, effort=effort)
    assert signatures() == before


@two_cores
def test_two_processes_fill_one_cache(tmp_path: Path) -> None:
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(tmp_path),
        "SSDR_NUM_THREADS": "2",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    first, second = (
        json.loads(
            subprocess.run(
                [sys.executable, "-c", _REPORT],
                env=environment,
                cwd=tmp_path,
                text=True,
                capture_output=True,
                check=True,
            ).stdout
        )
        for _ in range(2)
    )
    assert "solve_vertices" in first["compiled"]
    assert "polish_vertices" not in first["compiled"]
    assert second["compiled"] == []


def test_the_second_process_is_told_where_to_look(
    monkeypatch: pytest.MonkeyPatch, python: None, tmp_path: Path
) -> None:
    out = tmp_path / "told.json"
    program = f"import sys; open({str(out)!r}, 'w').write(sys.stdin.read())"
    monkeypatch.setattr(warmup, "_PROGRAM", program)
    second = warmup._Second()
    second.on_start(None)
    second.on_start(None)
    second.wait(60)
    told = json.loads(out.read_text())
    assert told == {"version": sys.version, "path": sys.path, "file": warmup.__file__}
    second.stop()


@pytest.mark.parametrize(
    ("program", "said"),
    [("import sys; sys.exit(3)", "(3)"), ("import time; time.sleep(60)", "(None)")],
)
def test_a_second_process_that_fails_or_hangs_is_given_up(
    program: str,
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    python: None,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(warmup, "_PROGRAM", program)
    second = warmup._Second()
    second.on_start(None)
    assert second.process is not None
    with caplog.at_level(logging.INFO, "ssdr.solver.warmup"):
        second.wait(3.0 if said == "(None)" else 60.0)
    second.stop()
    assert said in caplog.text
    assert second.process.poll() is not None


def test_what_cannot_be_started_is_logged(
    monkeypatch: pytest.MonkeyPatch, python: None, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python3"))
    second = warmup._Second()
    with caplog.at_level(logging.INFO, "ssdr.solver.warmup"):
        second.on_start(None)
    assert second.process is None
    assert "one process" in caplog.text
    second.wait(1.0)
    second.stop()


@pytest.mark.parametrize("name", ["maya.bin", "blender", "maya.exe", "", "pythonista", "mayapy"])
def test_a_host_program_is_never_started(
    name: str, monkeypatch: pytest.MonkeyPatch, python: None
) -> None:
    assert warmup._may_start()
    monkeypatch.setattr(sys, "executable", name and f"/opt/host/bin/{name}")
    assert not warmup._may_start()


@pytest.mark.parametrize("name", ["python", "python3", "python3.13t", "Python.exe", "pythonw.exe"])
def test_interpreters_go_by_many_names(
    name: str, monkeypatch: pytest.MonkeyPatch, python: None
) -> None:
    monkeypatch.setattr(sys, "executable", f"/usr/bin/{name}")
    assert warmup._may_start()


def test_workers_frozen_programs_and_one_thread_start_nothing(
    monkeypatch: pytest.MonkeyPatch, python: None
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(sys, "frozen", True, raising=False)
        assert not warmup._may_start()
    with monkeypatch.context() as patch:
        patch.setattr(warmup.multiprocessing, "parent_process", lambda: object())
        assert not warmup._may_start()
    parallel.set_threads(1)
    assert not warmup._may_start()
