"""Keyframe reduction: which keys of a bone can be left out, and the error that this adds."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..common.parallel import chunk_bounds, run_chunks
from .rigid import matrix_from_quaternion, quaternion_from_matrix, slerp, unflip_quaternions
from .size import key_bytes, time_bytes
from .skinning import Skinning
from .stretch import steady_axes
from .transforms import from_local, parents_first, rest_diagonal, to_local, translating

Array = NDArray[np.float64]

# Frames from one key to the next: all up to six, then each about a quarter larger.
_SPANS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32)
# Spans for more than _MANY frames × bones, since then each span takes a second or more.
_FEW_SPANS, _MANY = (1, 2, 4, 8), 2_000_000
_WHOLE_SHOTS = 8  # number of shots, from the first, whose length is a span as well
_BLOCK = 1 << 18  # frames × bones computed at a time


class Tracks:
    """Keys of every bone relative to its parent, and the error of leaving keys out.

    A key is the rotation and the position of a bone's joint relative to its parent.  Without a
    hierarchy, the centroid of the vertices that a bone moves serves as its joint.  Between keys
    positions and scales are interpolated linearly and rotations along the shortest arc, as in game
    engines; a matrix U S Vᵀ of an affine bone has a rotation U, scales S and another rotation Vᵀ.

    Let L be the transform of a bone relative to its parent, s the scale of the parent, and p a
    vertex in homogeneous coordinates of the bone.  If X replaces L, the vertex moves by
    s (X − L) p.  The sum of the squares over all vertices that move with the bone is
    s² tr((X − L) G (X − L)ᵀ), where G is the weighted sum of p pᵀ.  For rigid and similarity bones
    this is exact if one bone changes and each vertex has one influence; with several influences it
    is an upper bound (Jensen's inequality).  If several bones of a chain change, the error may be
    more or less than the sum of the bones' errors.

    Parameters
    ----------
    skinning : Skinning
    offsets : (S + 1,) int array
        First frame of each of the S shots, followed by the number of frames F.  The first and last
        frame of a shot are keys of every bone that has more than one key.

    Attributes
    ----------
    local : (F, B, 3, 4) float64
        Transforms of bones relative to their parents.  A bone that does not translate has the same
        position in all frames.
    spans : list of int
        Distances from one key to the next, in frames, that are tried, ascending.
    cost : list of (F − span, B) arrays
        For each span, the squared error of the frames between a key at frame t and the next key at
        t + span, for every t; inf if the keys are in different shots.
    still : (B,) int array
        Index of the frame whose transform, used in all frames, gives each bone the least error.
    still_cost : (B,) array
        Squared error of each bone with that transform in all frames.
    """

    def __init__(self, skinning: Skinning, offsets: NDArray[np.int64]) -> None:
        self.skinning = skinning
        self.affine = skinning.bone_model == "affine"
        m = np.asarray(skinning.transforms, dtype=np.float64)
        n_frames, n_bones = m.shape[:2]
        if skinning.parents is None:
            self.parents = np.full(n_bones, -1)
            self.positions = skinning.centroids()
            self.local = to_local(m, self.parents, self.positions)
        else:
            self.parents = skinning.parents
            self.positions = np.asarray(skinning.joint_positions, dtype=np.float64)
            self.local = to_local(m, self.parents, self.positions)
            moving = translating(m, self.parents, self.positions, rest_diagonal(skinning.rest))
            place = self.local[..., 3]
            place[:, ~moving] = place[:, ~moving].mean(axis=0)
        self._moment = self._moments()
        hung = np.flatnonzero(self.parents >= 0)
        self._size = np.ones(
            m.shape[:2]
        )  # squared scale of the parent; of affine parents its mean over directions
        linear = m[:, self.parents[hung], :, :3]
        self._size[:, hung] = np.einsum("tjab,tjab->tj", linear, linear) / 3
        self._scale, linear = np.ones((*m.shape[:2], 1)), self.local[..., :3]
        if skinning.bone_model == "similarity":
            self._scale = np.cbrt(np.linalg.det(linear))[..., None]
            linear = linear / self._scale[..., None]
        elif self.affine:
            linear, self._scale, within = steady_axes(linear)
            self._within = unflip_quaternions(quaternion_from_matrix(within))
        self._turn = unflip_quaternions(quaternion_from_matrix(linear))
        self._key_bytes = key_bytes(skinning)
        self._time_bytes = time_bytes(n_frames)
        whole = {int(n) - 1 for n in np.diff(offsets)[:_WHOLE_SHOTS] if 2 <= n <= _SPANS[-1] + 1}
        usual = _FEW_SPANS if n_frames * n_bones > _MANY else _SPANS
        self.spans = sorted({s for s in usual if s < max(2, n_frames)} | whole)
        self.cost = self._span_costs(offsets)
        self.still, self.still_cost = self._standing()

    def choose(self, price: float) -> tuple[NDArray[np.bool_], float]:
        """Mask (F, B) of the keys with least squared error + price · bytes, and the error added."""
        key = price * (self._key_bytes + self._time_bytes)
        n_frames, n_bones = self.local.shape[:2]
        bone = np.arange(n_bones)
        least = np.full((n_frames, n_bones), np.inf)
        came = np.ones((n_frames, n_bones), dtype=np.intp)  # span that ends at each frame
        least[0] = key
        for t in range(1, n_frames):
            for span, cost in zip(self.spans, self.cost, strict=True):
                if span > t:
                    break
                value = least[t - span] + cost[t - span] + key
                better = value < least[t]
                least[t, better] = value[better]
                came[t, better] = span
        keys = np.zeros((n_frames, n_bones), dtype=bool)
        at = np.full(n_bones, n_frames - 1)
        while (at > 0).any():
            keys[at, bone] = True
            at = np.maximum(at - came[at, bone], 0)
        keys[0] = True
        error = np.maximum(least[-1] - key * keys.sum(axis=0), 0.0)
        # a bone with a key at every frame stores no frame numbers
        every = price * self._key_bytes * n_frames
        full = every < least[-1]
        keys[:, full] = True
        still = self.still_cost + key <= np.minimum(every, least[-1])
        keys[:, still] = False
        keys[self.still[still], bone[still]] = True
        return keys, float(np.where(still, self.still_cost, np.where(full, 0.0, error)).sum())

    def play(self, keys: NDArray[np.bool_]) -> Skinning:
        """Skinning with keys where the mask `keys` (F, B) is True, interpolated between them."""
        n_frames = len(keys)
        frame = np.arange(n_frames)[:, None]
        before = np.maximum.accumulate(np.where(keys, frame, -1), axis=0)
        after = np.minimum.accumulate(np.where(keys, frame, n_frames)[::-1], axis=0)[::-1]
        first = np.where(before < 0, after, before)
        last = np.where(after >= n_frames, before, after)
        share = np.where(last > first, (frame - first) / np.maximum(last - first, 1), 0.0)
        local = np.where(keys[..., None, None], self.local, self._between(first, last, share))
        transforms = from_local(local, self.parents, self.positions)
        # if a bone and all its ancestors have a key, its transform is kept to the last bit
        whole = keys.copy()
        for b in parents_first(self.parents):
            if self.parents[b] >= 0:
                whole[:, b] &= whole[:, self.parents[b]]
        original = np.asarray(self.skinning.transforms, dtype=np.float64)
        transforms = np.where(whole[..., None, None], original, transforms)
        return dataclasses.replace(self.skinning, transforms=transforms, keyframes=keys)

    def _moments(self) -> Array:
        """Weighted second moments (F, B, 4, 4) of the vertices that move with each bone.

        Vertices of a bone's descendants move with it, too.  The coordinates are the bone's own.
        """
        s = self.skinning
        w = s.sparse_weights().astype(np.float64).tocoo()
        arm = np.ones((w.nnz, 4))
        arm[:, :3] = np.asarray(s.rest, dtype=np.float64)[w.coords[0]] - self.positions[w.coords[1]]
        own = np.zeros((s.n_bones, 4, 4))
        np.add.at(own, w.coords[1], w.data[:, None, None] * arm[:, :, None] * arm[:, None, :])
        moment = np.broadcast_to(own, (s.n_frames, *own.shape))
        if (self.parents < 0).all():
            return moment
        moment = moment.copy()
        for b in parents_first(self.parents)[::-1]:
            above = int(self.parents[b])
            if above >= 0:
                frame = np.zeros((s.n_frames, 4, 4))
                frame[:, :3], frame[:, 3, 3] = self.local[:, b], 1.0
                moment[:, above] += frame @ moment[:, b] @ np.swapaxes(frame, 1, 2)
        return moment

    def _between(self, first: NDArray[np.intp], last: NDArray[np.intp], share: Array) -> Array:
        """Local transforms (n, B, 3, 4) at the fraction `share` of the way from `first` to `last`.

        All three arrays are (n, B); `first` and `last` are frames with keys.
        """
        bone, u = np.arange(self.local.shape[1])[None], share[..., None, None]
        local = (1 - u) * self.local[first, bone] + u * self.local[last, bone]
        scale = (1 - u[..., 0]) * self._scale[first, bone] + u[..., 0] * self._scale[last, bone]
        turn = slerp(self._turn[first, bone], self._turn[last, bone], share)
        local[..., :3] = matrix_from_quaternion(turn) * scale[..., None, :]
        if self.affine:
            turn = slerp(self._within[first, bone], self._within[last, bone], share)
            local[..., :3] = local[..., :3] @ matrix_from_quaternion(turn)
        return local

    def _loss(self, local: Array, frames: slice) -> Array:
        """Squared error (n, B) of each bone if `local` replaces its transforms in `frames`."""
        off = local - self.local[frames]
        loss = np.einsum("tjab,tjab->tj", off @ self._moment[frames], off) * self._size[frames]
        return np.asarray(np.maximum(loss, 0.0))

    def _span_costs(self, offsets: NDArray[np.int64]) -> list[Array]:
        n_frames, n_bones = self.local.shape[:2]
        ends = np.zeros(n_frames, dtype=np.intp)
        ends[offsets[:-1]] = ends[offsets[1:] - 1] = 1
        before = np.concatenate([[0], np.cumsum(ends)])
        step = max(1, _BLOCK // n_bones)
        out = []
        for span in self.spans:
            cost = np.zeros((n_frames - span, n_bones))

            def work(_: int, i: int, k: int, span: int = span, cost: Array = cost) -> None:
                first = np.repeat(np.arange(i, k)[:, None], n_bones, axis=1)
                for inner in range(1, span):
                    local = self._between(first, first + span, np.full(first.shape, inner / span))
                    cost[i:k] += self._loss(local, slice(i + inner, k + inner))

            run_chunks(work, chunk_bounds(n_frames - span, step))
            start = np.arange(n_frames - span)
            cost[before[start + span] > before[start + 1]] = np.inf
            out.append(cost)
        return out

    def _standing(self) -> tuple[NDArray[np.intp], Array]:
        """Find for each bone the frame whose transform fits all frames best, and its error."""
        weighted = self._moment * self._size[..., None, None]
        local = self.local - self.local.mean(axis=0)  # avoids rounding errors far from the origin
        cross = np.einsum("tjab,tjbc->jac", local, weighted)
        cost = np.einsum("tjab,tjab->tj", local @ weighted.sum(axis=0), local)
        still = (cost - 2 * np.einsum("tjab,jab->tj", local, cross)).argmin(axis=0)
        off = self.local[still, np.arange(len(still))] - self.local
        return still, np.maximum(np.einsum("tjab,tjab->j", off @ weighted, off), 0.0)
