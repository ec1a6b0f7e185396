"""The model that the solver's steps change, and the parts of it that are kept."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..common.checks import BoneModel
from ..model.tree import Tree
from .trajectories import Array, Trajectories

# Most bones in a vertex's support, on which its weights are solved: more than K, so that a bone can
# come back, and few enough for a small dense solve.
SLOTS = 12
# Arrays of the vertices that a solve of vertices changes, in the order of its kernels.
SOLVED = ("rest", "indices", "weights", "error", "normals", "normal_error")
CHUNK = 512  # vertices of a task: the task takes milliseconds, and its arrays stay in the cache


class Skin(NamedTuple):
    """Bone indices and weights (V, K) of every vertex, largest weight first."""

    indices: NDArray[np.int32]
    weights: Array


@dataclasses.dataclass(eq=False)
class Model:
    """Transforms, rest pose and weights in the solver's space; steps change the arrays in place.

    Attributes
    ----------
    transforms : (F, B, 3, 4) float64
    rest : (V, 3) float64
    support : (V, SLOTS) int32
        Bones on which the weights of a vertex are solved.
    support_weights : (V, SLOTS) float64
        Weights of the bones in `support`.
    count : (V,) int32
        Number of used slots of `support`.
    indices : (V, K) int32
        The bones of `support` with the K largest weights, which skin the vertex.
    weights : (V, K) float64
        Weights of the bones in `indices`, solved again on these bones alone.
    error : (V,) float64
        Squared error of each vertex.
    normals : (V, P - 1, 3) float64
        Rest normals of the vertices, of any norm.  P is 2 while a solve fits them, and else 1.
    normal_error : (V,) float64
        Squared error Σ_t |Σ_j w_ij R_j^t n_i − n_i^t|² of each vertex's normal.
    tree : Tree or None
        Hierarchy of the bones.
    """

    transforms: Array
    rest: Array
    support: NDArray[np.int32]
    support_weights: Array
    count: NDArray[np.int32]
    indices: NDArray[np.int32]
    weights: Array
    error: Array
    normals: Array
    normal_error: Array
    tree: Tree | None = None

    @property
    def n_bones(self) -> int:
        return int(self.transforms.shape[1])

    @property
    def n_influences(self) -> int:
        return int(self.indices.shape[1])

    @property
    def hierarchy(self) -> Tree:
        """The tree, for models that are known to have one."""
        assert self.tree is not None
        return self.tree

    def copy(self) -> Model:
        arrays = {name: getattr(self, name).copy() for name in ARRAYS}
        return Model(**arrays, tree=self.tree)

    def vertex_rows(self, i: int, k: int) -> tuple[Any, ...]:
        """Rows i to k (views) of every array of the vertices, in the order of the attributes."""
        return tuple(getattr(self, name)[i:k] for name in ARRAYS[1:])

    def select_vertices(self, chosen: NDArray[np.intp]) -> Model:
        """A copy with the chosen vertices and all bones."""
        arrays = {k: np.ascontiguousarray(getattr(self, k)[chosen]) for k in ARRAYS[1:]}
        return Model(transforms=self.transforms.copy(), **arrays, tree=self.tree)

    def without_normals(self) -> Model:
        """This model (a view) without rest normals."""
        none = self.normals[:, :0], np.zeros(len(self.rest))
        return dataclasses.replace(self, normals=none[0], normal_error=none[1])

    @staticmethod
    def start(
        transforms: Array, rest: Array, label: NDArray[np.signedinteger[Any]], influences: int
    ) -> Model:
        """A model with K = `influences` slots, whose vertex i follows bone `label[i]` alone."""
        one = np.ones((len(rest), 1))
        return Model.with_weights(transforms, rest, label[:, None], one, influences)

    @staticmethod
    def with_weights(
        transforms: Array, rest: Array, indices: NDArray[Any], weights: Array, influences: int
    ) -> Model:
        """A model with the given weights, which come largest first, in K = `influences` slots."""
        n, slots, k = len(rest), max(SLOTS, influences), min(influences, indices.shape[1])
        model = Model(
            transforms=transforms,
            rest=rest.copy(),
            support=np.zeros((n, slots), dtype=np.int32),
            support_weights=np.zeros((n, slots)),
            count=np.ones(n, dtype=np.int32),
            indices=np.zeros((n, influences), dtype=np.int32),
            weights=np.zeros((n, influences)),
            error=np.full(n, np.inf),
            normals=np.zeros((n, 0, 3)),
            normal_error=np.zeros(n),
        )
        model.indices[:, :k], model.weights[:, :k] = indices[:, :k], weights[:, :k]
        model.restart_support()
        return model

    def weighted_error(self, data: Trajectories) -> float:
        """Squared error of all vertices, weighted by importance."""
        return float(data.importance @ self.error)

    def points(self, length: float) -> Array:
        """Points p̃ (V, P, 4): rest positions (p, 1), then normals (length · n, 0), if any."""
        n, more = self.normals.shape[:2]
        out = np.zeros((n, 1 + more, 4))
        out[:, 0, :3], out[:, 0, 3] = self.rest, 1.0
        out[:, 1:, :3] = length * self.normals
        return out

    def bone_masses(self) -> Array:
        """Masses (B,) Σ_i w_ij² of the bones: how much the motion of each bone counts."""
        squares = (self.weights**2).ravel()
        sums = np.bincount(self.indices.ravel(), weights=squares, minlength=self.n_bones)
        return np.asarray(sums, dtype=np.float64)

    def dense_weights(self) -> Array:
        """Weights of all vertices as a dense matrix (V, B)."""
        dense = np.zeros((len(self.rest), self.n_bones))
        np.add.at(dense, (np.arange(len(dense))[:, None], self.indices), self.weights)
        return dense

    def restart_support(self) -> None:
        """Reset the support to the bones of `indices` and their weights (in place)."""
        k = self.n_influences
        self.support[:] = 0
        self.support_weights[:] = 0.0
        self.support[:, :k] = self.indices
        self.support_weights[:, :k] = self.weights
        self.count[:] = np.maximum((self.weights > 0).sum(axis=1), 1)

    def assign_to_bone(self, vertices: NDArray[np.intp], bone: int) -> None:
        """Make `bone` the only bone in the support of the given vertices (in place)."""
        self.support[vertices], self.support_weights[vertices] = 0, 0.0
        self.support[vertices, 0], self.support_weights[vertices, 0] = bone, 1.0
        self.count[vertices] = 1

    def with_restarted_support(self) -> Model:
        """A copy after :meth:`restart_support`."""
        model = self.copy()
        model.restart_support()
        return model

    def with_influences(self, count: int) -> Model:
        """A copy with K = `count` slots, which keeps the largest weights of each vertex.

        The support is reset to these influences; errors are not computed again.
        """
        k = self.n_influences
        indices, weights = self.indices, self.weights
        if count < k:
            # in their present order; only vertices that lose weight are normalised again
            largest = np.sort(np.argsort(-weights, axis=1, kind="stable")[:, :count], axis=1)
            indices = np.take_along_axis(indices, largest, axis=1)
            weights = np.take_along_axis(weights, largest, axis=1)
            total = weights.sum(axis=1, keepdims=True)
            lost = np.count_nonzero(weights, axis=1) < np.count_nonzero(self.weights, axis=1)
            weights = np.where(lost[:, None], weights / total, weights)
        padding = ((0, 0), (0, max(0, count - k)))
        size = len(self.rest), max(self.support.shape[1], count)
        model = dataclasses.replace(
            self.copy(),
            support=np.zeros(size, dtype=np.int32),
            support_weights=np.zeros(size),
            indices=np.ascontiguousarray(np.pad(indices, padding)),
            weights=np.ascontiguousarray(np.pad(weights, padding)),
        )
        model.restart_support()
        return model

    def without(self, bones: NDArray[np.intp]) -> Model:
        """A copy without the given bones and without a tree; other bones stay in each support."""
        keep = np.setdiff1d(np.arange(self.n_bones), bones)
        rank = np.full(self.n_bones, -1, dtype=np.int32)
        rank[keep] = np.arange(len(keep))
        slots = np.arange(self.support.shape[1])
        support_weights = np.where(slots < self.count[:, None], self.support_weights, 0.0)
        gone = (support_weights > 0) & (rank[self.support] < 0)
        support_weights[gone] = 0.0
        order = np.argsort(-support_weights, axis=1, kind="stable")
        support_weights = np.take_along_axis(support_weights, order, axis=1)
        support = np.take_along_axis(np.maximum(rank[self.support], 0), order, axis=1)
        empty = support_weights[:, 0] <= 0
        support_weights[empty, 0] = 1.0
        support[empty, 0] = 0
        count = np.maximum((support_weights > 0).sum(axis=1), 1).astype(np.int32)
        # only those that lose weight are normalised again: kept weights keep their bits
        lost = gone.any(axis=1)
        support_weights[lost] /= support_weights[lost].sum(axis=1, keepdims=True)
        support[support_weights <= 0] = 0
        k = self.n_influences
        weights = support_weights[:, :k].copy()
        cut = count > k
        weights[cut] /= weights[cut].sum(axis=1, keepdims=True)
        return dataclasses.replace(
            self.copy(),
            transforms=np.ascontiguousarray(self.transforms[:, keep]),
            support=np.ascontiguousarray(support, dtype=np.int32),
            support_weights=support_weights,
            count=count,
            # a copy even where it is all of the support, since steps write to both
            indices=np.array(support[:, :k], dtype=np.int32, order="C"),
            weights=weights,
            tree=None,
        )

    def with_bone(self, transform: Array) -> Model:
        """A copy without a tree and with one more bone (F, 3, 4), which no vertex uses yet."""
        transforms = np.concatenate([self.transforms, transform[:, None]], axis=1)
        return dataclasses.replace(self.copy(), transforms=transforms, tree=None)


class Lowest:
    """The model of lowest value among those offered.

    Attributes
    ----------
    model : Model
        A copy, which steps on the offered model do not change.  The attribute does not exist before
        the first offer.
    value : float
        Its value; inf before the first offer.
    """

    model: Model
    value: float = math.inf

    @property
    def exists(self) -> bool:
        """Whether a model was offered."""
        return self.value < math.inf

    def offer(self, model: Model, value: float) -> bool:
        """Keep a copy of the model if `value` is below the lowest so far; return whether it is."""
        lower = value < self.value
        if lower:
            self.model, self.value = model.copy(), value
        return lower


ARRAYS = tuple(f.name for f in dataclasses.fields(Model) if f.name != "tree")  # transforms first


@dataclasses.dataclass(frozen=True, eq=False)
class Constraints:
    """Parts of a model that steps leave as they are, and the kind of transforms of its bones.

    Attributes
    ----------
    lock_rest : bool
        Whether the rest pose is locked.
    weights : (V,) or (0,) bool array
        Mask of the vertices whose weights are locked; empty if none are.
    bone_model : {"rigid", "similarity", "affine"}
        Kind of transforms that bones have.
    lock_joints : bool
        Whether the joints of a tree are locked.
    near_skin : bool
        Whether the objective penalises the distance of a joint from where the skin of its two bones
        meets.
    """

    lock_rest: bool = False
    weights: NDArray[np.bool_] = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=bool))
    bone_model: BoneModel = "rigid"
    lock_joints: bool = False
    near_skin: bool = False

    def select_vertices(self, chosen: NDArray[np.intp]) -> Constraints:
        """A copy whose mask of locked weights has only the chosen vertices."""
        known = chosen if len(self.weights) else chosen[:0]
        return dataclasses.replace(self, weights=self.weights[known])

    def with_weights(self, n: int) -> Constraints:
        """A copy in which the weights of all n vertices are locked."""
        return dataclasses.replace(self, weights=np.ones(n, dtype=bool))

    def vertex_mask(self, n: int) -> NDArray[np.bool_]:
        """Mask (n,) of the vertices whose weights are locked, for n vertices."""
        return np.pad(self.weights, (0, n - len(self.weights)))


FREE = Constraints()
