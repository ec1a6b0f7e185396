"""Samples of the vertices, and models of all vertices made from models of a sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ..solver.initialization import by_motion
from ..solver.model import Model
from ..solver.trajectories import Array, Trajectories

LEAST, MOST = 48, 128  # bounds of the number of vertices of a sample, per bone


def sample_size(n_vertices: int, bones: int, least: int = LEAST, most: int = MOST) -> int:
    """Number of vertices of a sample: a third of all, between `least` and `most` per bone."""
    return min(most * bones, max(least * bones, n_vertices // 3))


def motion_sample(data: Trajectories, count: int) -> NDArray[np.intp]:
    """Indices of `count` vertices, ascending, evenly spaced in the order of :func:`by_motion`."""
    every = np.linspace(0, data.n_vertices - 1, count).round().astype(np.intp)
    return np.sort(by_motion(data)[every])


def model_of_all(few: Model, rest: Array, chosen: NDArray[np.intp]) -> Model:
    """Model of all vertices, made from `few`, a model of the vertices `chosen`.

    Each vertex has the weights of the nearest chosen vertex, and the same offset from it as in the
    pose `rest` (V, 3).  Its errors are not computed.
    """
    nearest = np.asarray(cKDTree(rest[chosen]).query(rest)[1])
    model = few.select_vertices(nearest)
    model.rest = model.rest + rest - rest[chosen][nearest]
    model.restart_support()
    return model
