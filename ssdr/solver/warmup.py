"""Kernels made ready before the clock starts: loaded from the cache on disk, or compiled."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numba
import numpy as np

from ..kernels import polish
from ..kernels.lbs import squared_error_range
from ..parallel import get_threads
from ..sequence import MeshSequence
from .alternation import bone_costs, bone_step, vertex_step
from .model import Model
from .moments import bone_sums
from .polish import Polish
from .trajectories import Trajectories, gather

__all__ = ["compile_kernels", "compile_polish"]

_logger = logging.getLogger(__name__)
_ready = False
_LONGEST = 300.0  # seconds that another process gets: with more, something is wrong with it


def compile_kernels() -> float:
    """Load or compile every kernel on a toy problem, once a process; seconds that it took.

    With nothing on disk, another process compiles those of the polish meanwhile: Numba compiles
    one at a time in each.
    """
    global _ready
    if _ready:
        return 0.0
    began = time.perf_counter()
    helper = _start_helper()
    try:
        data, model = _toy()
        vertex_step(data, model)
        bone_costs(data, model)
        squared_error_range(
            model.rest,
            model.joints,
            model.weights,
            model.transforms[:1],
            np.zeros((1, data.n_vertices, 3)),
            0,
            1,
            np.zeros(data.n_vertices),
        )
        bone_step(data, model)
    finally:
        _wait_for(helper)
    compile_polish()
    _ready = True
    seconds = time.perf_counter() - began
    _logger.info("kernels ready after %.2f s", seconds)
    return seconds


def compile_polish() -> None:
    """Load or compile the kernels of the polish."""
    data, model = _toy()
    # first, for the alternation needs it too
    bone_sums(data, model.joints, model.weights, model.rest, model.n_bones)
    Polish(data, model).step(entering=1)


def _toy() -> tuple[Trajectories, Model]:
    data = gather([MeshSequence(np.random.default_rng(0).standard_normal((3, 8, 3)))], bones=2)
    transforms = np.zeros((3, 2, 3, 4))
    transforms[..., :3] = np.eye(3)
    return data, Model.start(transforms, data.frame(0), np.arange(8) % 2, 2)


def _start_helper() -> subprocess.Popen[bytes] | None:
    """A process that compiles the kernels of the polish; None where there is no use for one."""
    name = Path(sys.executable or "").stem.lower()
    if not name.startswith("python") or getattr(sys, "frozen", False) or get_threads() < 2:
        return None  # an application with Python inside would start itself again
    if _cached(polish.polish_vertices):
        return None
    path = [entry for entry in sys.path if isinstance(entry, str)]
    program = (
        f"import sys; sys.path[:] = {path!r}; from {__name__} import compile_polish as go; go()"
    )
    folder = numba.config.CACHE_DIR  # type: ignore[attr-defined]  # not in its stubs
    environment = {**os.environ, **({"NUMBA_CACHE_DIR": folder} if folder else {})}
    try:
        return subprocess.Popen(
            [sys.executable, "-c", program],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except OSError as error:  # such as no memory left: one process compiles all
        _logger.info("no second process to compile in: %s", error)
        return None


def _wait_for(helper: subprocess.Popen[bytes] | None) -> None:
    """Until it has ended; what it did not leave on disk is compiled here."""
    if helper is None:
        return
    try:
        if helper.wait(_LONGEST):
            _logger.info("the second process that compiles ended with %d", helper.returncode)
    except subprocess.TimeoutExpired:
        helper.kill()
        helper.wait()


def _cached(kernel: Any) -> bool:
    """Whether there is a compiled kernel on disk (or no place for one) that is not out of date."""
    stats = getattr(kernel, "stats", None)
    if stats is None or not stats.cache_path:
        return True
    version = f"py{sys.version_info.major}{sys.version_info.minor}"
    source = Path(kernel.py_func.__code__.co_filename)
    try:
        written = source.stat().st_mtime
        found = Path(stats.cache_path).glob(f"*.{kernel.__name__}-*.{version}*.nbi")
        return any(index.stat().st_mtime >= written for index in found)
    except OSError:
        return True
