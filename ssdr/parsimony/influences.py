"""Fewer influences a vertex, each the one whose loss costs least."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..parallel import serial_blas
from ..solver.model import Fixed, Model
from ..solver.moments import transform_sums
from ..solver.trajectories import Array, Trajectories
from ..solver.vertex_newton import newton_vertices

__all__ = ["Nested", "nest", "refit"]


def refit(data: Trajectories, model: Model, *, fixed: Fixed, rounds: int = 2) -> None:
    """Weights on the supports that they have, and rest pose, under given transforms (in place)."""
    with serial_blas():
        _, gram, gram4, reduced = transform_sums(data, model.transforms)
        newton_vertices(
            lambda i, k: data.z[i:k] @ reduced,
            data.x2,
            (gram, gram4),
            model,
            fixed=fixed,
            entering=0,
            rounds=rounds,
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Nested:
    """A model with fewer and fewer influences at every vertex.

    Attributes
    ----------
    models : tuple of Model
        The m-th has at most K − m influences a vertex, each the best to drop
        after those before.
    errors : (M, V) float64
    counts : (M, V) int
    """

    models: tuple[Model, ...]
    errors: Array
    counts: NDArray[np.int64]

    def choose(self, importance: Array, price: float) -> tuple[NDArray[np.intp], float]:
        """For each vertex the level of least cost, where an influence costs `price`; the error."""
        cost = self.errors * importance + price * self.counts
        # of equal costs the one of fewer influences
        level = len(cost) - 1 - cost[::-1].argmin(axis=0)
        error = float(importance @ np.take_along_axis(self.errors, level[None], axis=0)[0])
        return level, error

    def build(self, level: NDArray[np.intp]) -> Model:
        """The model whose vertices are at the given levels."""
        out = self.models[0].copy()
        for m, model in enumerate(self.models):
            rows = level == m
            for name in ("rest", "indices", "weights", "error"):
                getattr(out, name)[rows] = getattr(model, name)[rows]
        out.restart_support()
        return out


def nest(data: Trajectories, model: Model, *, fixed: Fixed) -> Nested:
    """Drop influences one by one, at every vertex the one that costs least after a new solve."""
    models = [model.copy()]
    refit(data, models[0], fixed=fixed, rounds=4)
    while models[-1].n_influences > 1 and (models[-1].weights[:, 1:] > 0).any():
        last = models[-1]
        best: Model | None = None
        used = last.weights > 0
        several = used.sum(axis=1) > 1
        for slot in range(last.n_influences):
            there = several & used[:, slot]
            if not there.any():
                continue
            trial = last.copy()
            trial.weights[there, slot] = 0.0
            trial.weights /= trial.weights.sum(axis=1, keepdims=True)
            order = np.argsort(-trial.weights, axis=1, kind="stable")
            trial.weights = np.take_along_axis(trial.weights, order, axis=1)
            trial.indices = np.ascontiguousarray(np.take_along_axis(trial.indices, order, axis=1))
            trial.indices[trial.weights == 0] = 0
            refit(data, trial, fixed=fixed, rounds=4)
            trial.error[several & ~used[:, slot]] = np.inf
            if best is None:
                best = trial
                continue
            better = trial.error < best.error
            for name in ("rest", "indices", "weights", "error"):
                getattr(best, name)[better] = getattr(trial, name)[better]
        if best is None:
            break
        models.append(best)
    return Nested(
        models=tuple(models),
        errors=np.maximum(np.stack([m.error for m in models]), 0.0),
        counts=np.stack([(m.weights > 0).sum(axis=1) for m in models]),
    )
