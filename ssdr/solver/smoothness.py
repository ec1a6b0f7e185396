"""Optional smoothness of the weights over the mesh."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from ..checks import LARGEST
from .model import Model
from .trajectories import Array, Trajectories

__all__ = ["WeightSmoothness"]


@dataclasses.dataclass(frozen=True, eq=False)
class WeightSmoothness:
    """The penalty λ Σ_edges |w_i − w_k|² and its separable upper bound.

    L ⪯ 2D for a graph Laplacian, so that at the current weights w⁰ the penalty is
    at most a constant plus Σ_i 2λd_i|w_i|² − 2λ w_iᵀ(2d_i w_i⁰ − (Lw⁰)_i): every
    vertex is solved by itself and the sum still cannot rise.
    """

    adjacency: csr_array
    degree: Array
    strength: float
    importance: Array

    @staticmethod
    def build(
        data: Trajectories, faces: NDArray[np.int32], smoothness: float
    ) -> WeightSmoothness | None:
        """The penalty of a checked `smoothness`; None where it is 0."""
        if smoothness == 0:
            return None
        n = data.n_vertices
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        edges = edges[edges[:, 0] != edges[:, 1]]
        i, k = np.concatenate([edges, edges[:, ::-1]]).T
        adjacency = csr_array(coo_array((np.ones(len(i)), (i, k)), shape=(n, n)))
        adjacency.data[:] = 1.0
        degree = np.asarray(adjacency.sum(axis=1), dtype=np.float64).ravel()
        # beyond that the error counts for nothing, and the square need not be a number
        strength = data.n_frames * min(smoothness / data.scale, LARGEST) ** 2
        return WeightSmoothness(adjacency, degree, strength, np.maximum(data.importance, 1e-6))

    def terms(self, model: Model) -> tuple[Array, Array]:
        """`pull` (V, B) and `stiff` (V,) of the vertex step."""
        w = _dense(model)
        around = np.asarray(self.adjacency @ w)
        scale = self.strength / self.importance
        pull = scale[:, None] * (around + self.degree[:, None] * w)
        return np.ascontiguousarray(pull), 2.0 * scale * self.degree

    def penalty(self, model: Model) -> float:
        """λ Σ_edges |w_i − w_k|²."""
        w = _dense(model)
        around = np.asarray(self.adjacency @ w)
        jumps = float(np.vdot(w, self.degree[:, None] * w - around))
        return self.strength * max(jumps, 0.0)  # equal weights: zero to rounding, either side


def _dense(model: Model) -> Array:
    w = np.zeros((len(model.rest), model.n_bones))
    np.add.at(w, (np.arange(len(w))[:, None], model.indices), model.weights)
    return w
