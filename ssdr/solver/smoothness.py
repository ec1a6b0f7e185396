"""Optional penalty on weights that differ along edges of the mesh."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, diags_array

from ..checks import LARGEST
from .model import Model
from .trajectories import Array, Trajectories

__all__ = ["WeightSmoothness", "strength_of"]


def strength_of(data: Trajectories, length: float) -> float:
    """Factor with which |w|² costs as much as an error of a `length` in the input's units."""
    # bounded, since the square must not overflow; near the bound the error hardly counts anyway
    return data.n_frames * min(length / data.scale, LARGEST) ** 2


@dataclasses.dataclass(frozen=True, eq=False)
class WeightSmoothness:
    """The penalty λ Σ_edges |w_i − w_k|², and an upper bound of it that is a sum over vertices.

    The graph Laplacian L satisfies L ⪯ 2D, where D is the diagonal matrix of the vertex degrees
    d_i.  For present weights w⁰, the penalty is therefore at most a constant plus Σ_i [2λ d_i
    |w_i|² − 2λ w_iᵀ (2d_i w_i⁰ − (L w⁰)_i)], with equality at w⁰.  So solving the vertices one by
    one under this bound cannot raise the objective.

    Attributes
    ----------
    adjacency : (V, V) sparse array
        1 for each edge of the mesh.
    degree : (V,) array
    strength : float
        λ.
    importance : (V,) array
        Importance of the vertices, at least 1e-6.
    """

    adjacency: csr_array
    degree: Array
    strength: float
    importance: Array

    @staticmethod
    def build(
        data: Trajectories, faces: NDArray[np.int32], smoothness: float
    ) -> WeightSmoothness | None:
        """The penalty for a mesh and a checked `smoothness`; None if `smoothness` is 0."""
        if smoothness == 0:
            return None
        from ..laplacian.operators import uniform_laplacian  # which most solves need not load

        laplacian = uniform_laplacian(faces, data.n_vertices)
        degree = laplacian.diagonal()
        adjacency = csr_array(diags_array(degree) - laplacian)
        strength = strength_of(data, smoothness)
        return WeightSmoothness(adjacency, degree, strength, np.maximum(data.importance, 1e-6))

    def terms(self, model: Model) -> tuple[Array, Array]:
        """`pull` (V, B) and `stiff` (V,) of the vertex step: the bound at the model's weights."""
        w = model.dense_weights()
        around = np.asarray(self.adjacency @ w)
        scale = self.strength / self.importance
        pull = scale[:, None] * (around + self.degree[:, None] * w)
        return np.ascontiguousarray(pull), 2.0 * scale * self.degree

    def penalty(self, model: Model) -> float:
        """The penalty λ Σ_edges |w_i − w_k|² of a model."""
        w = model.dense_weights()
        around = np.asarray(self.adjacency @ w)
        jumps = float(np.vdot(w, self.degree[:, None] * w - around))
        return self.strength * max(jumps, 0.0)  # rounding may make 0 negative
