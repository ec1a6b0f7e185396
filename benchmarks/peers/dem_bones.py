"""Dem Bones through its binding: a solver that is stepped from outside, and its model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from benchmarks.peers.model_size import skinned_e

Found = tuple[np.ndarray, np.ndarray]  # weights (V, B) and transforms (F, B, 3, 4)


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


def iterates(solver: Any, n_frames: int, iterations: int) -> Iterator[Found]:
    """Its start, and its model after each iteration."""
    solver.init()
    yield model_of(solver, n_frames)
    for _ in range(iterations):
        solver.computeTranformations()
        solver.computeWeights()
        yield model_of(solver, n_frames)


def lowest(
    frames: np.ndarray, rest: np.ndarray, models: Iterable[Found]
) -> tuple[list[float], Found | None]:
    """E of every model, and the model of least E; None if no E is a number."""
    errors: list[float] = []
    least, best = np.inf, None
    for weights, transforms in models:
        errors.append(skinned_e(frames, rest, weights, transforms))
        if errors[-1] < least:
            least, best = errors[-1], (weights.copy(), transforms.copy())
    return errors, best


def model_of(solver: Any, n_frames: int) -> Found:
    weights = np.asarray(solver.get_weights(), dtype=np.float64).T
    m = np.asarray(solver.m, dtype=np.float64).reshape(n_frames, 4, -1, 4)
    return weights, m.transpose(0, 2, 1, 3)[:, :, :3]
