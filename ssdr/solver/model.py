"""The model that the solver's steps pass on, and what of it stays fixed."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..hierarchy.tree import Tree
from ..skinning import BoneModel
from .trajectories import Array, Trajectories

__all__ = [
    "Fixed",
    "Model",
]

# Size of the unpruned support that stays warm from step to step: beyond K, so that a bone can
# come back, and no more than a small dense solve takes.
SLOTS = 12
CHUNK = 512  # vertices a chunk of work: a few milliseconds, and its arrays stay in the cache


@dataclasses.dataclass(eq=False)
class Model:
    """Transforms, rest pose and weights in normalised space; arrays are updated in place."""

    transforms: Array  # (F, B, 3, 4)
    rest: Array  # (V, 3)
    support: NDArray[np.int32]  # (V, SLOTS)
    support_weights: Array  # (V, SLOTS)
    count: NDArray[np.int32]  # (V,)
    indices: NDArray[np.int32]  # (V, K)
    weights: Array  # (V, K)
    error: Array  # (V,) squared error of indices, weights, rest, transforms
    tree: Tree | None = None  # the hierarchy of the bones

    @property
    def n_bones(self) -> int:
        return int(self.transforms.shape[1])

    @property
    def n_influences(self) -> int:
        return int(self.indices.shape[1])

    def copy(self) -> Model:
        arrays = {name: getattr(self, name).copy() for name in ARRAYS}
        return Model(**arrays, tree=self.tree)

    def vertices(self, chosen: NDArray[np.intp]) -> Model:
        """A copy of the chosen vertices alone, with all bones."""
        arrays = {
            name: np.ascontiguousarray(getattr(self, name)[chosen])
            for name in ARRAYS
            if name != "transforms"
        }
        return Model(transforms=self.transforms.copy(), **arrays, tree=self.tree)

    @staticmethod
    def start(
        transforms: Array, rest: Array, label: NDArray[np.signedinteger[Any]], influences: int
    ) -> Model:
        """One bone a vertex."""
        n = len(rest)
        slots = max(SLOTS, influences)
        support = np.zeros((n, slots), dtype=np.int32)
        support_weights = np.zeros((n, slots))
        indices = np.zeros((n, influences), dtype=np.int32)
        weights = np.zeros((n, influences))
        support[:, 0] = indices[:, 0] = label
        support_weights[:, 0] = weights[:, 0] = 1.0
        return Model(
            transforms=transforms,
            rest=rest.copy(),
            support=support,
            support_weights=support_weights,
            count=np.ones(n, dtype=np.int32),
            indices=indices,
            weights=weights,
            error=np.full(n, np.inf),
        )

    @staticmethod
    def with_weights(
        transforms: Array, rest: Array, indices: NDArray[np.int32], weights: Array, influences: int
    ) -> Model:
        """Weights as they are handed over, the largest first, in `influences` slots."""
        model = Model.start(transforms, rest, indices[:, 0], influences)
        k = min(influences, indices.shape[1])
        model.indices[:, :k], model.weights[:, :k] = indices[:, :k], weights[:, :k]
        model.restart_support()
        return model

    def objective(self, data: Trajectories) -> float:
        return float(data.importance @ self.error)

    def bone_masses(self) -> Array:
        """(B,) Σ_i w_ij² of each bone: how much its motion counts."""
        squares = (self.weights**2).ravel()
        sums = np.bincount(self.indices.ravel(), weights=squares, minlength=self.n_bones)
        return np.asarray(sums, dtype=np.float64)

    def restart_support(self) -> None:
        """Let the unpruned support restart from the weights that were kept."""
        k = self.n_influences
        self.support[:] = 0
        self.support_weights[:] = 0.0
        self.support[:, :k] = self.indices
        self.support_weights[:, :k] = self.weights
        self.count[:] = np.maximum((self.weights > 0).sum(axis=1), 1)

    def with_restarted_support(self) -> Model:
        """A copy whose unpruned support restarts from the weights that were kept."""
        model = self.copy()
        model.restart_support()
        return model

    def with_influences(self, count: int) -> Model:
        """A copy with `count` slots for influences, the largest kept where they were more.

        The error is that of before.
        """
        k = self.n_influences
        indices, weights = self.indices, self.weights
        if count < k:
            # in the order they stand, and to the bit where nothing is lost
            largest = np.sort(np.argsort(-weights, axis=1, kind="stable")[:, :count], axis=1)
            indices = np.take_along_axis(indices, largest, axis=1)
            weights = np.take_along_axis(weights, largest, axis=1)
            total = weights.sum(axis=1, keepdims=True)
            lost = np.count_nonzero(weights, axis=1) < np.count_nonzero(self.weights, axis=1)
            weights = np.where(lost[:, None], weights / total, weights)
        padding = ((0, 0), (0, max(0, count - k)))
        wide = ((0, 0), (0, max(0, count - self.support.shape[1])))
        model = Model(
            transforms=self.transforms.copy(),
            rest=self.rest.copy(),
            support=np.pad(self.support, wide),
            support_weights=np.pad(self.support_weights, wide),
            count=self.count.copy(),
            indices=np.ascontiguousarray(np.pad(indices, padding)),
            weights=np.ascontiguousarray(np.pad(weights, padding)),
            error=self.error.copy(),
            tree=self.tree,
        )
        model.restart_support()
        return model

    def without(self, bones: NDArray[np.intp]) -> Model:
        """A copy that has lost some bones; vertices keep what is left of their support.

        It has no tree.
        """
        keep = np.setdiff1d(np.arange(self.n_bones), bones)
        rank = np.full(self.n_bones, -1, dtype=np.int32)
        rank[keep] = np.arange(len(keep))
        slots = np.arange(self.support.shape[1])
        support_weights = np.where(slots < self.count[:, None], self.support_weights, 0.0)
        support_weights[rank[self.support] < 0] = 0.0
        order = np.argsort(-support_weights, axis=1, kind="stable")
        support_weights = np.take_along_axis(support_weights, order, axis=1)
        support = np.take_along_axis(np.maximum(rank[self.support], 0), order, axis=1)
        empty = support_weights[:, 0] <= 0
        support_weights[empty, 0] = 1.0
        support[empty, 0] = 0
        count = np.maximum((support_weights > 0).sum(axis=1), 1).astype(np.int32)
        support_weights /= support_weights.sum(axis=1, keepdims=True)
        support[support_weights <= 0] = 0
        k = self.n_influences
        weights = support_weights[:, :k] / support_weights[:, :k].sum(axis=1, keepdims=True)
        return Model(
            transforms=np.ascontiguousarray(self.transforms[:, keep]),
            rest=self.rest.copy(),
            support=np.ascontiguousarray(support, dtype=np.int32),
            support_weights=support_weights,
            count=count,
            # a copy also where all of the support is kept: steps write to both
            indices=np.array(support[:, :k], dtype=np.int32, order="C"),
            weights=weights,
            error=self.error.copy(),
        )

    def with_bone(self, transform: Array) -> Model:
        """A copy with one bone more, (F, 3, 4), that nothing uses yet, and without a tree."""
        grown = dataclasses.replace(self.copy(), tree=None)
        grown.transforms = np.ascontiguousarray(
            np.concatenate([self.transforms, transform[:, None]], axis=1)
        )
        return grown


ARRAYS = tuple(f.name for f in dataclasses.fields(Model) if f.name != "tree")


@dataclasses.dataclass(frozen=True, eq=False)
class Fixed:
    """What a caller wants left alone, and what bones may do."""

    rest: bool = False
    weights: NDArray[np.bool_] | None = None  # (V,) vertices whose weights stay
    bones: NDArray[np.bool_] | None = None  # (B,) bones whose transforms stay
    bone_model: BoneModel = "rigid"
    joints: bool = False  # joints of a tree
    near_skin: bool = False  # whether a tree's joints are drawn to where skin meets
    # (F, B0, 3, 3) rotations relative to the parent that bones of a tree keep; NaN: free
    turns: NDArray[np.float64] | None = None

    def of_vertices(self, chosen: NDArray[np.intp]) -> Fixed:
        """The same for the chosen vertices alone."""
        weights = None if self.weights is None else self.weights[chosen]
        return dataclasses.replace(self, weights=weights)

    def keep_weights(self, n: int) -> NDArray[np.bool_]:
        return np.zeros(n, dtype=bool) if self.weights is None else self.weights

    def locked(self, n: int) -> NDArray[np.bool_]:
        if self.bones is None:
            return np.zeros(n, dtype=bool)
        return np.concatenate([self.bones, np.zeros(n - len(self.bones), dtype=bool)])

    def kept_turns(self, tree: Tree) -> list[tuple[int, int, NDArray[np.float64]]]:
        """Bones whose rotation relative to their parent stays, parents first: bone, parent, it."""
        if self.turns is None:
            return []
        there = self.turns.shape[1]
        order = [int(j) for j in tree.order if j < there and tree.parents[j] >= 0]
        kept = [j for j in order if not np.isnan(self.turns[0, j, 0, 0])]
        return [(j, int(tree.parents[j]), self.turns[:, j]) for j in kept]


FREE = Fixed()


def pad_influences(model: Model, influences: int) -> tuple[NDArray[np.int32], Any]:
    """Joints and weights with exactly K columns."""
    more = influences - model.n_influences
    if more <= 0:
        return model.indices, model.weights
    widths = ((0, 0), (0, more))
    return np.pad(model.indices, widths), np.pad(model.weights, widths)
