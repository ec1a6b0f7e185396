"""Kernels are ready before the clock starts, and compiled once a machine."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import ssdr
from ssdr.kernels import (
    bones,
    coupling,
    influence_choice,
    lbs,
    normals,
    removal,
    schur,
    vertex_polish,
    vertices,
)
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


def signatures() -> dict[str, int]:
    modules = (
        *(bones, coupling, influence_choice, lbs, normals, removal, schur, vertex_polish),
        vertices,
    )
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
    assert before["ssdr.kernels.vertex_polish.polish_vertices"] >= 1
    ssdr.decompose(rng.standard_normal((5, 40, 3)), [[0, 1, 2]], bones=4, effort=effort)
    assert signatures() == before


@pytest.mark.parametrize("why", ["cached", "one thread", "inside another program"])
def test_no_process_is_started_in_vain(why: str, monkeypatch: pytest.MonkeyPatch) -> None:
    started = []
    monkeypatch.setattr(warmup, "_ready", False)
    monkeypatch.setattr(warmup, "_beside", None)
    monkeypatch.setattr(warmup, "is_cached", lambda kernel: why == "cached")
    monkeypatch.setattr(warmup, "get_threads", lambda: 1 if why == "one thread" else 2)
    program = "/opt/maya/bin/maya.bin" if why.startswith("inside") else sys.executable
    monkeypatch.setattr(sys, "executable", program)
    monkeypatch.setattr(subprocess, "Popen", lambda *args, **kwargs: started.append(args))
    warmup.begin_compiling()
    assert not started
    monkeypatch.setattr(warmup, "is_cached", lambda kernel: False)
    monkeypatch.setattr(warmup, "get_threads", lambda: 2)
    monkeypatch.setattr(sys, "executable", "/usr/bin/python3")
    warmup.begin_compiling()
    assert len(started) == 1


@pytest.mark.slow
def test_what_one_process_compiles_the_next_one_loads() -> None:
    """The first one may have found all of it compiled."""
    command, paths = [sys.executable, "-c", _REPORT], os.pathsep.join(sys.path)
    environment = {**os.environ, "SSDR_NUM_THREADS": "2", "PYTHONPATH": paths}
    for _ in range(2):
        done = subprocess.run(command, env=environment, text=True, capture_output=True, check=True)
    assert json.loads(done.stdout)["compiled"] == []
