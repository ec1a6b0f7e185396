"""Fewer keyframes: the motion of every bone as keys, and what it costs to leave some out."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..parallel import chunk_bounds, run_chunks
from ..rigid import matrix_from_quaternion, quaternion_from_matrix, slerp, unflip_quaternions
from ..skinning import Skinning
from ..solver.trajectories import Array
from .report import key_bytes, time_bytes
from .tree import Tree

__all__ = ["Tracks"]

# frames from a key to the next: every number up to six, then about a quarter more each
_SPANS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32)
# beyond so many frames × bones, where each span is a second or more
_FEW_SPANS, _MANY = (1, 2, 4, 8), 2_000_000
_BLOCK = 1 << 18  # frames × bones at a time


class Tracks:
    """The motion of every bone as keys, and what it costs to leave some out.

    A bone is a turn about, and a place of, the centroid of what it moves; between
    keys the place runs straight and the turn along the shortest arc (matrices of
    affine bones: straight), as engines play them.  In a hierarchy turn and place
    are those of the joint relative to its parent, and what is left out of a joint
    counts for all that hangs on it, were everything else as it is: what is left
    out of several joints of a chain may add to more, or to less.

    Parameters
    ----------
    skinning : Skinning
    offsets : (S + 1,) int array
        First frame of each shot: it and the last one of each stay keys.
    """

    def __init__(self, skinning: Skinning, offsets: NDArray[np.int64]) -> None:
        self.skinning = skinning
        self.affine = skinning.bone_model == "affine"
        m = np.asarray(skinning.transforms, dtype=np.float64)
        self.centre = skinning.centroids()
        self.tree = None if skinning.parents is None else Tree(skinning)
        if self.tree is None:
            self.place = np.einsum("tjab,jb->tja", m[..., :3], self.centre) + m[..., 3]
        else:
            m = self.tree.local
            self.place = m[..., 3]
        linear = m[..., :3]
        self.scale = np.ones(m.shape[:2])
        if skinning.bone_model == "similarity":
            self.scale = np.cbrt(np.linalg.det(linear))
            linear = linear / self.scale[..., None, None]
        self.linear = linear
        if not self.affine:
            self.turn = unflip_quaternions(quaternion_from_matrix(linear))
        self.key_bytes = key_bytes(skinning)
        self.time_bytes = time_bytes(len(m))
        self.forced = np.zeros(len(m), dtype=bool)
        self.forced[offsets[:-1]] = self.forced[offsets[1:] - 1] = True
        if self.tree is None:
            self._root, self._mass = self._moments()
            self._feature = self._features(linear * self.scale[..., None, None], self.place)
        many = m.shape[0] * m.shape[1] > _MANY
        whole = {int(n) - 1 for n in np.diff(offsets)[:8] if 2 <= n <= _SPANS[-1] + 1}
        usual = {s for s in (_FEW_SPANS if many else _SPANS) if s < max(2, len(m))}
        self.spans = sorted(usual | whole)
        self.cost = self._span_costs()
        self.still, self.still_cost = self._standing()

    def _moments(self) -> tuple[Array, Array]:
        """Σ w (p−c)(p−c)ᵀ of every bone as a root (B, 3, 3), and Σ w (B,).

        Weights to the first power: by Jensen's inequality the sum over bones then
        bounds what vertices of several bones move.
        """
        s = self.skinning
        n_bones = s.n_bones
        p = np.asarray(s.rest, dtype=np.float64)
        w = s.sparse_weights().astype(np.float64).tocoo()
        arm = p[w.coords[0]] - self.centre[w.coords[1]]
        moment = np.zeros((n_bones, 3, 3))
        np.add.at(moment, w.coords[1], w.data[:, None, None] * arm[:, :, None] * arm[:, None, :])
        values, vectors = np.linalg.eigh(moment)
        root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
        mass = np.bincount(w.coords[1], weights=w.data, minlength=n_bones)
        return root, np.asarray(mass, dtype=np.float64)

    def _features(self, linear: Array, place: Array) -> Array:
        """(..., B, 12): squared distances between them are squared errors of vertices."""
        turned = np.einsum("...jab,jbc->...jac", linear, self._root)
        moved = place * np.sqrt(self._mass)[:, None]
        return np.concatenate([turned.reshape(*turned.shape[:-2], 9), moved], axis=-1)

    def _between(self, first: NDArray[np.intp], last: NDArray[np.intp], share: Array) -> Array:
        """Features (n, B, 12) at a share of the way between keys at frames (n, B)."""
        linear, place = self._mix(first, last, share)
        out = self._features(linear, place)
        if self.affine:
            out[np.linalg.det(linear) <= 0] = np.inf  # on the straight way a bone may turn over
        return out

    def _mix(
        self, first: NDArray[np.intp], last: NDArray[np.intp], share: Array
    ) -> tuple[Array, Array]:
        bone = np.arange(self.place.shape[1])[None]
        u = share[..., None]
        place = (1 - u) * self.place[first, bone] + u * self.place[last, bone]
        if self.affine:
            v = u[..., None]
            return (1 - v) * self.linear[first, bone] + v * self.linear[last, bone], place
        a, b = self.turn[first, bone], self.turn[last, bone]
        scale = (1 - share) * self.scale[first, bone] + share * self.scale[last, bone]
        return matrix_from_quaternion(slerp(a, b, share)) * scale[..., None, None], place

    def _span_costs(self) -> list[Array]:
        """For every span (F − span, B): squared error of the frames that it leaves out."""
        n_frames, n_bones = self.place.shape[:2]
        out = []
        step = max(1, _BLOCK // n_bones)
        for span in self.spans:
            cost = np.zeros((n_frames - span, n_bones))
            blocked = np.concatenate([[0], np.cumsum(self.forced)])

            def work(_: int, i: int, k: int, span: int = span, cost: Array = cost) -> None:
                first = np.repeat(np.arange(i, k)[:, None], n_bones, axis=1)
                for inner in range(1, span):
                    share = np.full(first.shape, inner / span)
                    if self.tree is not None:
                        linear, place = self._mix(first, first + span, share)
                        cost[i:k] += self.tree.loss(linear, place, slice(i + inner, k + inner))
                        continue
                    gone = self._between(first, first + span, share)
                    gone -= self._feature[i + inner : k + inner]
                    cost[i:k] += np.einsum("tja,tja->tj", gone, gone)

            run_chunks(work, chunk_bounds(n_frames - span, step))
            start = np.arange(n_frames - span)
            cost[blocked[start + span] > blocked[start + 1]] = np.inf
            out.append(cost)
        return out

    def _standing(self) -> tuple[NDArray[np.intp], Array]:
        """For every bone the frame at which it had best stand still, and what that costs."""
        if self.tree is not None:
            return self.tree.standing()
        mean = self._feature.mean(axis=0)
        off = self._feature - mean
        still = np.einsum("tja,tja->tj", off, off).argmin(axis=0)
        gone = self._feature - self._feature[still, np.arange(len(still))]
        return still, np.einsum("tja,tja->j", gone, gone)

    def choose(self, price: float) -> tuple[NDArray[np.bool_], float]:
        """Keys (F, B) of least error where a byte costs `price`, and the squared error added."""
        byte, key = price, price * (self.key_bytes + self.time_bytes)
        n_frames, n_bones = self.place.shape[:2]
        best = np.full((n_frames, n_bones), np.inf)
        came = np.ones(
            (n_frames, n_bones), dtype=np.intp
        )  # where nothing is better, from frame to frame
        best[0] = key
        for t in range(1, n_frames):
            for k, span in enumerate(self.spans):
                if span > t:
                    break
                value = best[t - span] + self.cost[k][t - span] + key
                better = value < best[t]
                best[t, better] = value[better]
                came[t, better] = span
        keys = np.zeros((n_frames, n_bones), dtype=bool)
        at = np.full(n_bones, n_frames - 1)
        bone = np.arange(n_bones)
        while (at > 0).any():
            keys[at, bone] = True
            at = np.maximum(at - came[at, bone], 0)
        keys[0] = True
        count = keys.sum(axis=0)
        error = np.maximum(best[-1] - key * count, 0.0)
        # with a key at every frame no times are stored
        full = byte * self.key_bytes * n_frames < error + key * count
        keys[:, full] = True
        error = np.where(full, 0.0, error)
        whole = np.where(full, byte * self.key_bytes * n_frames, best[-1])
        still = self.still_cost + key <= whole
        keys[:, still] = False
        keys[self.still[still], bone[still]] = True
        return keys, float(np.where(still, self.still_cost, error).sum())

    def play(self, keys: NDArray[np.bool_]) -> Skinning:
        """The skinning whose transforms between keys are interpolated, its keys said."""
        n_frames = len(keys)
        frame = np.arange(n_frames)[:, None]
        before = np.maximum.accumulate(np.where(keys, frame, -1), axis=0)
        after = np.minimum.accumulate(np.where(keys, frame, n_frames)[::-1], axis=0)[::-1]
        first = np.where(before < 0, after, before)
        last = np.where(after >= n_frames, before, after)
        share = np.where(last > first, (frame - first) / np.maximum(last - first, 1), 0.0)
        linear, place = self._mix(first, last, share)
        if self.tree is not None:
            transforms = self.tree.play(linear, place, keys)
            return dataclasses.replace(self.skinning, transforms=transforms, keyframes=keys)
        shift = place - np.einsum("tjab,jb->tja", linear, self.centre)
        transforms = np.concatenate([linear, shift[..., None]], axis=-1)
        # keys are what they were, to the last bit
        original = np.asarray(self.skinning.transforms, dtype=np.float64)
        transforms = np.where(keys[..., None, None], original, transforms)
        return dataclasses.replace(self.skinning, transforms=transforms, keyframes=keys)
