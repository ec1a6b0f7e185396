"""Dem Bones through its binding: a solver that is stepped from outside, and its model."""

from __future__ import annotations

from typing import Any

import numpy as np


def prepared(
    frames: np.ndarray,
    faces: Any,
    bones: int,
    influences: int,
    *,
    rest: np.ndarray | None = None,
    regularised: bool = True,
) -> Any:
    """Solver with its data set, not started; the rest pose is frame 0 if none is given.

    Both regularisers have their defaults, or are 0.
    """
    from py_dem_bones._py_dem_bones import DemBones
    from py_dem_bones.portable import _prepare_solver

    solver = DemBones()
    if not regularised:
        solver.weightsSmooth = solver.transAffine = 0.0
    pose = np.asarray(frames[0] if rest is None else rest, dtype=np.float64)
    _prepare_solver(pose, frames, bones, faces=faces, max_influences=influences, solver=solver)
    return solver


def model_of(solver: Any, n_frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (V, B) and transforms (F, B, 3, 4)."""
    weights = np.asarray(solver.get_weights(), dtype=np.float64).T
    m = np.asarray(solver.m, dtype=np.float64).reshape(n_frames, 4, -1, 4)
    return weights, m.transpose(0, 2, 1, 3)[:, :, :3]
