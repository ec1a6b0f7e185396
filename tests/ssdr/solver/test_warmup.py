"""Kernels are ready before the clock starts, and compiled once a machine."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ssdr
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
from ssdr.kernels.polish import polish_vertices
loaded = sum(polish_vertices.stats.cache_hits.values()) > 0
print(json.dumps({"compiled": names.found, "loaded": loaded, "seconds": seconds}))
"""


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


def test_what_one_process_compiles_the_next_one_loads(tmp_path: Path) -> None:
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(tmp_path),
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
    # with two threads another process compiles those of the polish
    assert first["loaded"] == (warmup.get_threads() > 1)
    assert ("polish_vertices" in first["compiled"]) != first["loaded"]
    assert second["compiled"] == []


@pytest.mark.parametrize("executable", ["", "/opt/blender/blender"])
def test_an_application_with_python_inside_is_not_started_again(
    executable: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(warmup, "_cached", lambda _: False)
    monkeypatch.setattr(warmup, "get_threads", lambda: 2)
    monkeypatch.setattr(sys, "executable", executable)
    assert warmup._start_helper() is None


@pytest.mark.parametrize("program", ["import sys; sys.exit(3)", "import time; time.sleep(60)"])
def test_a_second_process_that_fails_or_hangs_is_done_without(
    program: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(warmup, "_LONGEST", 0.5)
    helper = subprocess.Popen([sys.executable, "-c", program])
    warmup._wait_for(helper)
    assert helper.returncode != 0


def test_a_kernel_of_an_older_source_is_out_of_date(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    version = f"py{sys.version_info.major}{sys.version_info.minor}"
    source, index = tmp_path / "kernels.py", tmp_path / f"kernels.solve-3.{version}.nbi"
    source.write_text("")

    class Kernel:
        __name__ = "solve"
        stats = type("Stats", (), {"cache_path": str(tmp_path)})
        py_func = type("Function", (), {"__code__": compile("", str(source), "exec")})

    assert not warmup._cached(Kernel())
    index.write_text("")
    assert warmup._cached(Kernel())
    os.utime(index, (0, 0))
    assert not warmup._cached(Kernel())
