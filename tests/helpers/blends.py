"""Blends of more bones than the model has, and the model that a search begins with."""

from __future__ import annotations

import numpy as np

import ssdr
from helpers import motions, naive
from ssdr.solver.alternation import repeat_alternation, vertex_step
from ssdr.solver.initialization import start_model
from ssdr.solver.model import FREE, Model
from ssdr.solver.trajectories import Trajectories, gather

BONES, INFLUENCES = 7, 2


def problem(seed: int, noise: float = 0.01) -> tuple[Trajectories, Model]:
    """Blends of three of nine bones, and a first model of seven with two a vertex."""
    rng = np.random.default_rng(seed)
    rest = rng.standard_normal((90, 3))
    frames = motions.random_skinning(rng, rest, 8, 9, 3)
    frames += noise * rng.standard_normal(frames.shape)
    data = gather([ssdr.MeshSequence(frames)], bones=99)
    model = start_model(data, data.frame(0), BONES, INFLUENCES, rng)
    vertex_step(data, model)
    repeat_alternation(data, model, 6, FREE)
    return data, model


def squared_error(data: Trajectories, model: Model) -> float:
    """Squared error of the model by naive skinning."""
    skinned = naive.skin(model.rest, model.indices, model.weights, model.transforms)
    target = np.stack([data.frame(t) for t in range(data.n_frames)])
    return float(((skinned - target) ** 2).sum())
