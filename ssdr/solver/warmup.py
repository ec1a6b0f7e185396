"""Loading or compilation of all kernels, so that the measured time of a solve excludes it."""

from __future__ import annotations

import logging
import time

import numpy as np

from ..frames.error import squared_error
from ..frames.normals import drawn_angles, with_fitted_normals
from ..sequence import MeshSequence
from ..skinning import Skinning
from .alternation import bone_costs, bone_step, vertex_step
from .gauss_newton import GaussNewton
from .model import Model
from .trajectories import gather

__all__ = ["compile_kernels"]

_logger = logging.getLogger(__name__)
_ready = False


def compile_kernels() -> float:
    """Load or compile every kernel, once per process, and return the seconds that it took."""
    global _ready
    if _ready:
        return 0.0
    began = time.perf_counter()
    sequence = MeshSequence(np.random.default_rng(0).standard_normal((3, 8, 3)), [[0, 1, 2]])
    data = gather([sequence], bones=2)
    transforms = np.zeros((3, 2, 3, 4))
    transforms[..., :3] = np.eye(3)
    model = Model.start(transforms, data.frame(0), np.arange(8) % 2, 2)
    vertex_step(data, model)
    bone_step(data, model)
    bone_costs(data, model)
    parts = model.rest, model.indices, model.weights, model.transforms
    squared_error([sequence], *parts)
    skinning = Skinning(*parts, faces=sequence.faces)
    drawn_angles([sequence], with_fitted_normals([sequence], skinning))
    GaussNewton(data, model).step(entering=1)
    _ready = True
    seconds = time.perf_counter() - began
    _logger.info("kernels ready after %.2f s", seconds)
    return seconds
