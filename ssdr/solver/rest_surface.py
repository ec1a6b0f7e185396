"""A rest pose that stays a surface: a factor of the objective that grows as its edges change.

Positions in the frames hardly determine the rest pose: patches that one bone moves alone may lie
anywhere in it, and small weights make up for large steps between neighbours.  Solved for positions
alone, it becomes a crumpled mesh whose normals, weights and distances are of no use.  So the
objective has the factor 1 + c·S, where the strain

    S = Σ_edges ω |(p_i − p_j) − (h_i − h_j)|² / Σ_edges ω |h_i − h_j|²

compares the edges of the rest pose p with those of a pose h of the input.  As a factor it costs the
same share of the error whatever the error is, and nothing where a model is exact.

The logarithm of a product is majorised by the linear terms of its factors (log is concave), and the
squared difference along an edge by a term for each end (|a − b|² <= 2|a − m|² + 2|b − m|²).  That
leaves a quadratic pull on each rest position alone, so that vertices are still solved one by one,
and no step that lowers the error with these pulls raises the objective.  The polish of all bones
uses the first bound alone (:mod:`~ssdr.solver.vertex_elimination`).

References
----------
Hunter and Lange, "A tutorial on MM algorithms", 2004.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from ..common.parallel import serial_blas
from ..kernels.normals import normals_range
from ..mesh.edges import distinct_pairs, triangle_edges
from ..mesh.normals import triangle_normals

Array = NDArray[np.float64]
RestPose = Literal["surface", "free"]

# c: an error 1 + c·S times as large is as bad as a strain S; an edge rotated by 20° has S = 0.12.
_STRENGTH = 3.0
# Added to an edge's squared length in 1/ω, relative to the mean, so that no short edge dominates.
SHORT = 0.1
_RINGS = 4  # of edges around a fold that may move as it unfolds


@dataclasses.dataclass(frozen=True, eq=False)
class RestSurface:
    """Edges of the pose that a rest pose is to resemble.

    Attributes
    ----------
    pose : (V, 3) array
        h, in the solver's space.
    edges : (V, V) sparse array
        Weights ω of the edges, symmetric, with Σ_edges ω |h_i − h_j|² = 1.
    degree : (V,) array
        Row sums of `edges`.
    """

    pose: Array
    edges: csr_array
    degree: Array

    @staticmethod
    @serial_blas()
    def build(faces: NDArray[np.int32], pose: Array) -> RestSurface | None:
        """The surface of `pose` with the triangles `faces`; None if no edge has a length."""
        return RestSurface._of_edges(pose.copy(), triangle_edges(faces, len(pose)))

    @staticmethod
    def _of_edges(pose: Array, ends: NDArray[np.int64]) -> RestSurface | None:
        squared = ((pose[ends[:, 0]] - pose[ends[:, 1]]) ** 2).sum(axis=1)
        if not squared.any():
            return None
        weight = 1.0 / (squared + SHORT * squared.mean())
        weight /= weight @ squared
        n = len(pose)
        i, j = ends.T
        both = (np.r_[weight, weight], (np.r_[i, j], np.r_[j, i]))
        edges = csr_array(coo_array(both, shape=(n, n)))
        return RestSurface(pose, edges, np.asarray(edges.sum(axis=1), dtype=float).ravel())

    @serial_blas()
    def sampled(self, chosen: NDArray[np.intp]) -> RestSurface | None:
        """The surface of the vertices `chosen` alone.

        Two of them are joined if an edge joins a vertex nearest to one and a vertex nearest to the
        other.
        """
        nearest = np.asarray(cKDTree(self.pose[chosen]).query(self.pose)[1])
        pairs = nearest[np.stack(self.edges.nonzero(), axis=1)]
        return RestSurface._of_edges(self.pose[chosen], distinct_pairs(pairs, len(chosen)))

    def factor(self, rest: Array) -> float:
        """The factor 1 + c·S of a rest pose (V, 3)."""
        moved = rest - self.pose
        return self._factor_of(moved, self.edges @ moved)

    def _factor_of(self, moved: Array, around: Array) -> float:
        strain = float(np.vdot(moved, self.degree[:, None] * moved - around))
        return 1.0 + _STRENGTH * max(strain, 0.0)

    def pulls(self, rest: Array, error: float, importance: Array) -> Array:
        """Pulls (V, 4) at a rest pose: stiffness μ and target m of the terms μ |p_i − m|².

        `error` is the squared error of the model.  The stiffness is divided by the `importance`
        (V,), since a term is added to its vertex's error before importance multiplies the sum.
        """
        moved = rest - self.pose
        around = np.asarray(self.edges @ moved)
        some = np.maximum(self.degree, 1e-300)[:, None]
        out = np.empty((len(rest), 4))
        strength = _STRENGTH * error / self._factor_of(moved, around)
        out[:, 0] = self.stiffness(strength, importance)
        out[:, 1:] = self.pose + 0.5 * (moved + around / some)
        return out

    def strength(self, rest: Array, error: float) -> float:
        """λ, by which Σ_edges ω |change|² adds to the squared error `error` at a rest pose."""
        return _STRENGTH * error / self.factor(rest)

    def rows(self, strength: float) -> tuple[NDArray[Any], NDArray[np.uint32], Array]:
        """Bounds (V + 1,) of each vertex's edges, their other ends, and λω for a λ = `strength`."""
        return self.edges.indptr, self.edges.indices.astype(np.uint32), strength * self.edges.data

    def stiffness(self, strength: float, importance: Array) -> Array:
        """Stiffness (V,) of the pulls for a λ = `strength`, divided by the importance."""
        return 2.0 * strength * self.degree / np.maximum(importance, 1e-6)

    def turned(self, rest: Array, faces: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Mask (T,) of the triangles that are flipped in a rest pose, but not in the pose h.

        The normal of a flipped triangle points against those of its vertices.
        """
        return _turned(rest, faces) & ~_turned(self.pose, faces)

    def tilted(self, rest: Array, faces: NDArray[np.int32], cosine: float) -> NDArray[np.bool_]:
        """Mask (T,) of the triangles whose normals in a rest pose and in h have a lower cosine."""
        dot = (triangle_normals(rest, faces) * triangle_normals(self.pose, faces)).sum(axis=1)
        return np.asarray(dot < cosine)

    def stiffened(self, faces: NDArray[np.int32], factor: float) -> RestSurface:
        """A copy in which the edges of the triangles `faces` have `factor` times the weight."""
        ends = triangle_edges(faces, len(self.pose))
        i, j = np.concatenate([ends, ends[:, ::-1]]).T
        mask = coo_array((np.ones(len(i)), (i, j)), shape=self.edges.shape).tocsr()
        mask.data[:] = factor - 1.0
        edges = csr_array(self.edges + self.edges.multiply(mask))
        return RestSurface(self.pose, edges, np.asarray(edges.sum(axis=1), dtype=float).ravel())

    def around(self, faces: NDArray[np.int32]) -> NDArray[np.intp]:
        """Indices of the vertices of `faces`, and of those at most four edges away from them."""
        reached = np.zeros(len(self.pose))
        reached[faces] = 1.0
        for _ in range(_RINGS):
            reached += self.edges @ reached
        return np.flatnonzero(reached)


def _turned(points: Array, faces: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Mask (T,) of flipped triangles, whose normals oppose the normals of their vertices."""
    around = np.empty((1, *points.shape))
    normals_range(points[None], faces, faces, around, 0, 1)
    a, b, c = points[faces].transpose(1, 0, 2)
    own = np.cross(b - a, c - a)
    return np.asarray((own * around[0][faces].sum(axis=1)).sum(axis=1) < 0)
