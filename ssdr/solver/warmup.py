"""Loading or compilation of all kernels, so that the measured time of a solve excludes it."""

from __future__ import annotations

import dataclasses
import logging
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from ..common.parallel import get_threads
from ..kernels.influence_choice import choose_influences
from ..kernels.policy import SHIPPED, is_cached
from ..kernels.vertex_polish import polish_vertices
from ..mesh.sequence import MeshSequence
from ..model.drawn_normals import drawn_angles, with_fitted_normals
from ..model.frame_error import squared_error
from ..model.skinning import Skinning
from .alternation import bone_costs, bone_step, vertex_step
from .gauss_newton import GaussNewton
from .model import FREE, Model
from .moments import transform_sums
from .rest_surface import RestSurface
from .trajectories import Trajectories, gather

_logger = logging.getLogger(__name__)
_ready = bool(SHIPPED)
_beside: subprocess.Popen[bytes] | None = None


def begin_compiling() -> None:
    """Start a process that compiles half of the kernels, unless the cache already holds them.

    A compiler uses one core, so that the second process costs no time on another.  If it fails,
    :func:`compile_kernels` compiles everything.
    """
    global _beside
    # if Python is embedded, this is the host program, which cannot run the code
    python = Path(sys.executable or "").name.startswith("python")
    if _ready or _beside or not python or get_threads() < 2 or is_cached(polish_vertices):
        return
    code = f"from {__name__} import compile_second_half; compile_second_half()"
    _beside = subprocess.Popen(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def compile_kernels() -> float:
    """Load or compile every kernel, once per process, and return the seconds that it took."""
    global _ready
    if _ready:
        return 0.0
    began = time.perf_counter()
    begin_compiling()
    _, data, model = _toy()
    vertex_step(data, model)
    bone_step(data, model)
    bone_costs(data, model)
    _, gram, _, reduced = transform_sums(data, model.transforms)
    sums = data.products(slice(None), reduced, 0.0), data.squares(slice(None), 0.0)
    rows = model.rest, model.indices, model.weights, model.normals
    choose_influences(*sums, gram, *rows, 0.0, FREE.vertex_mask(data.n_vertices), 1)
    if _beside is not None:
        _beside.wait()
    compile_second_half()
    _ready = True
    seconds = time.perf_counter() - began
    _logger.info("kernels ready after %.2f s", seconds)
    return seconds


def compile_second_half() -> None:
    """Load or compile the second half of the kernels, measured by compile time.

    A second process can compile them in parallel, as they share few helpers with the others.
    """
    sequence, data, model = _toy()
    surface = RestSurface.build(sequence.faces, data.frame(0))
    model.error[:] = 1.0  # without an error, edges have no strength
    GaussNewton(dataclasses.replace(data, surface=surface), model, damping=1.0).step(entering=-1)
    parts = model.rest, model.indices, model.weights, model.transforms
    squared_error([sequence], *parts)
    skinning = Skinning(*parts, faces=sequence.faces)
    drawn_angles([sequence], with_fitted_normals([sequence], skinning))


def _toy() -> tuple[MeshSequence, Trajectories, Model]:
    sequence = MeshSequence(np.random.default_rng(0).standard_normal((3, 8, 3)), [[0, 1, 2]])
    data = gather([sequence], bones=2)
    transforms = np.zeros((3, 2, 3, 4))
    transforms[..., :3] = np.eye(3)
    return sequence, data, Model.start(transforms, data.frame(0), np.arange(8) % 2, 2)
