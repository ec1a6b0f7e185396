"""Kernels made ready before the clock starts: loaded from the cache, or compiled by two processes.

Numba compiles behind one lock, so that threads gain nothing.  Where a kernel of
the first half turns out not to be cached, a second Python compiles those of the
polish into the same cache, from which this process then loads them.  Whatever
goes wrong there costs time alone: what is not in the cache is compiled here.
"""

from __future__ import annotations

import json
import logging
import multiprocessing
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numba.core import event

from ..kernels.lbs import squared_error_range
from ..parallel import get_threads
from .alternation import bone_costs, bone_step, vertex_step
from .model import Model
from .polish import Polish
from .trajectories import Trajectories, gather

__all__ = ["compile_kernels"]

_logger = logging.getLogger(__name__)

_ready = False
_PATIENCE = 2.0  # times the first half's seconds that the second process may take beyond it
# Isolated, so that no module of the working directory is imported; then the very path of this
# process.  Another interpreter than this one would fill another cache.
_PROGRAM = """
import json, sys
told = json.load(sys.stdin)
if told["version"] != sys.version:
    sys.exit(3)
sys.path[:] = told["path"]
from ssdr.solver import warmup
if warmup.__file__ != told["file"]:
    sys.exit(4)
warmup.polish_half()
"""


def compile_kernels() -> float:
    """Load or compile every kernel on a toy problem, once a process; seconds that it took."""
    global _ready
    if _ready:
        return 0.0
    began = time.perf_counter()
    second = _Second()
    try:
        with event.install_listener("numba:compile", second):
            _alternation_half()
        second.wait(_PATIENCE * (time.perf_counter() - began))
        polish_half()
    finally:
        second.stop()
    _ready = True
    seconds = time.perf_counter() - began
    _logger.info("kernels ready after %.2f s", seconds)
    return seconds


def polish_half() -> None:
    """Run every kernel of the polish."""
    data, model = _toy()
    polish = Polish(data, model)
    polish.step(entering=1)


def _alternation_half() -> None:
    data, model = _toy()
    vertex_step(data, model)
    bone_step(data, model)
    bone_costs(data, model)
    target = np.zeros((1, data.n_vertices, 3))
    squared_error_range(
        model.rest,
        model.joints,
        model.weights,
        model.transforms[:1],
        target,
        0,
        1,
        np.zeros(data.n_vertices),
    )


def _toy() -> tuple[Trajectories, Model]:
    from ..sequence import MeshSequence

    rng = np.random.default_rng(0)
    data = gather([MeshSequence(rng.standard_normal((3, 8, 3)))], bones=2)
    transforms = np.zeros((3, 2, 3, 4))
    transforms[..., :3] = np.eye(3)
    return data, Model.start(transforms, data.frame(0), np.arange(8) % 2, 2)


class _Second(event.Listener):
    """A process that starts when the first kernel is about to be compiled here."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[str] | None = None
        self.tried = not _may_start()

    def on_start(self, event: Any) -> None:
        if not self.tried:
            self.tried = True
            self._start()

    def on_end(self, event: Any) -> None:
        pass

    def _start(self) -> None:
        told = {"version": sys.version, "path": sys.path, "file": __file__}
        try:
            self.process = subprocess.Popen(
                [sys.executable, "-I", "-c", _PROGRAM],
                text=True,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
            assert self.process.stdin is not None
            with self.process.stdin as stream:
                stream.write(json.dumps(told))
        except (OSError, ValueError, TypeError) as error:
            _logger.info("kernels are compiled by one process: %s", error)

    def wait(self, seconds: float) -> None:
        if self.process is None:
            return
        try:
            code = self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            code = None
        if code != 0:
            _logger.info("the second compiling process failed (%s); compiling here", code)

    def stop(self) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()


def _may_start() -> bool:
    """Whether a second Python may be started, and would help."""
    # A program that Python is embedded in (Maya, for one) gives its own name: never start that.
    python = re.fullmatch(r"pythonw?[\d.]*[td]*(\.exe)?", Path(sys.executable or "").name.lower())
    frozen = getattr(sys, "frozen", False)
    # Workers of a pool are as many as there are cores, and warm up at the same time.
    worker = multiprocessing.parent_process() is not None
    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity else (os.cpu_count() or 1)
    return python is not None and not frozen and not worker and min(cores, get_threads()) > 1
