"""Local keys of a hierarchy: what it costs to leave some of a joint's out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..hierarchy.transforms import from_local, parents_first, rest_diagonal, to_local, translating
from ..skinning import Skinning
from ..solver.trajectories import Array

__all__ = ["Tree"]


class Tree:
    """Joints relative to their parents, and what hangs on each in every frame.

    Where joint b is at X instead of at L relative to its parent, a vertex p in its frame moves by
    s (X − L) p, with s the size of the parent.  Over all that hangs on b, vertices weighted, the
    squares of it sum to s² tr (X − L) S (X − L)ᵀ, where S is the second moment of that in
    homogeneous coordinates.  Where bones are rigid or similarities this is exact for one joint and
    vertices of one influence; of several it is an upper bound (Jensen's inequality).

    Parameters
    ----------
    skinning : Skinning
        With a hierarchy.

    Attributes
    ----------
    local : (F, B, 3, 4) float64
        Joints that do not translate have one translation in all frames.
    """

    def __init__(self, skinning: Skinning) -> None:
        self.skinning = skinning
        self.parents, self.positions = skinning.parents, skinning.joint_positions
        m = np.asarray(skinning.transforms, dtype=np.float64)
        self.local = to_local(m, self.parents, self.positions)
        still = ~translating(m, self.parents, self.positions, rest_diagonal(skinning.rest))
        place = self.local[..., 3]
        place[:, still] = place[:, still].mean(axis=0)
        self._moment = self._moments()
        hung = np.flatnonzero(self.parents >= 0)
        self._size = np.ones(m.shape[:2])  # squared; of an affine parent the mean over directions
        linear = m[:, self.parents[hung], :, :3]
        self._size[:, hung] = np.einsum("tjab,tjab->tj", linear, linear) / 3

    def _moments(self) -> Array:
        """Second moments (F, B, 4, 4) of all that hangs on a joint, in its frame."""
        s = self.skinning
        w = s.sparse_weights().astype(np.float64).tocoo()
        arm = np.ones((w.nnz, 4))
        arm[:, :3] = np.asarray(s.rest, dtype=np.float64)[w.coords[0]] - self.positions[w.coords[1]]
        own = np.zeros((s.n_bones, 4, 4))
        np.add.at(own, w.coords[1], w.data[:, None, None] * arm[:, :, None] * arm[:, None, :])
        moment = np.tile(own, (s.n_frames, 1, 1, 1))
        for b in parents_first(self.parents)[::-1]:
            above = int(self.parents[b])
            if above >= 0:
                frame = np.zeros((s.n_frames, 4, 4))
                frame[:, :3], frame[:, 3, 3] = self.local[:, b], 1.0
                moment[:, above] += frame @ moment[:, b] @ np.swapaxes(frame, 1, 2)
        return moment

    def loss(self, linear: Array, place: Array, frames: slice) -> Array:
        """Squared error (n, B) of each joint that is so, instead of as it is in these frames."""
        gone = np.concatenate([linear, place[..., None]], axis=-1) - self.local[frames]
        loss = np.einsum("tjab,tjab->tj", gone @ self._moment[frames], gone) * self._size[frames]
        if self.skinning.bone_model == "affine":
            loss[np.linalg.det(linear) <= 0] = np.inf  # on the straight way a bone may turn over
        return np.asarray(np.maximum(loss, 0.0))

    def standing(self) -> tuple[NDArray[np.intp], Array]:
        """For every joint the frame at which it had best stand still, and what that costs."""
        weighted = self._moment * self._size[..., None, None]
        total = weighted.sum(axis=0)
        cross = np.einsum("tjab,tjbc->jac", self.local, weighted)
        cost = np.einsum("tjab,tjab->tj", self.local @ total, self.local)
        still = (cost - 2 * np.einsum("tjab,jab->tj", self.local, cross)).argmin(axis=0)
        held = self.local[still, np.arange(len(still))]
        gone = held - self.local
        return still, np.maximum(np.einsum("tjab,tjab->j", gone @ weighted, gone), 0.0)

    def play(self, linear: Array, place: Array, keys: NDArray[np.bool_]) -> Array:
        """Transforms (F, B, 3, 4) of joints that are so between their keys."""
        local = np.concatenate([linear, place[..., None]], axis=-1)
        local = np.where(keys[..., None, None], self.local, local)
        transforms = from_local(local, self.parents, self.positions)
        # where nothing above is between keys, bones are what they were, to the last bit
        whole = keys.copy()
        for b in parents_first(self.parents):
            if self.parents[b] >= 0:
                whole[:, b] &= whole[:, self.parents[b]]
        original = np.asarray(self.skinning.transforms, dtype=np.float64)
        return np.where(whole[..., None, None], original, transforms)
