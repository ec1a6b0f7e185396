"""Skeletons as engines play them: joints, keys, stored weights, and the error of storing them.

With a hierarchy, its joints and local transforms are stored. A bone without one has no joint of
its own; it gets one at the centroid of what it moves, so that an engine that interpolates
translation and rotation between two keys stays near the surface: a rotation about a far origin
would sweep the bone along a chord.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..clips import Clip, unique_names
from ..errors import InputError, check_choice
from ..hierarchy.transforms import (
    from_frames,
    rest_diagonal,
    rest_offsets,
    to_local,
    to_world,
    translating,
)
from ..rigid import matrix_from_quaternion, quaternion_from_matrix, slerp, unflip_quaternions
from ..skinning import Skinning, skin
from .registry import SaveReport
from .storage import StorageError, frame_blocks
from .tables import weight_rows

WeightStorage = Literal["float32", "uint16", "uint8"]

# frames per second in use in film, television and motion capture
_RATES = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 100.0, 120.0)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Rig:
    """A skinning as a skeleton of joints, in the precision of its storage.

    Keys of a joint are relative to its parent; those of a root, and all without a hierarchy, are
    relative to the world.

    Attributes
    ----------
    rest : (V, 3) float32
    indices : (V, K) int32
    weights : (V, K) float32, uint16 or uint8
        As stored, in steps of 1/65535 or 1/255 where they are integers; descending, no bone twice.
    centers : (B, 3) float32
        Joints in the rest pose.
    rotations : (F, B, 4) float32
        Unit quaternions xyzw whose sign never flips from a frame to the next.
    translations : (F, B, 3) float32
        Position of each joint.
    scales : (F, B) float32 or None
        None: all are 1.
    parents : (B,) int32 or None
        -1 at roots; None without a hierarchy.
    offsets : (B, 3) float32
        Position of each joint in the rest pose, relative to its parent; the only position of a
        joint that does not translate.
    translating : (B,) bool
        Which joints store their `translations`.
    keys : (F, B) bool
        Frames that are stored.
    names : tuple of str
    clips : tuple of Clip
    axes : (B, 3, 3) float64 or None
        With a hierarchy: orientations of the joints in the rest pose; None: those of the world.
    """

    rest: NDArray[np.float32]
    indices: NDArray[np.int32]
    weights: NDArray[Any]
    centers: NDArray[np.float32]
    rotations: NDArray[np.float32]
    translations: NDArray[np.float32]
    scales: NDArray[np.float32] | None
    parents: NDArray[np.int32] | None
    offsets: NDArray[np.float32]
    translating: NDArray[np.bool_]
    keys: NDArray[np.bool_]
    names: tuple[str, ...]
    clips: tuple[Clip, ...]
    axes: NDArray[np.float64] | None = None

    @property
    def n_frames(self) -> int:
        return len(self.rotations)

    @property
    def n_bones(self) -> int:
        return len(self.centers)

    def matrices(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transforms ``(n, B, 3, 4)`` from the stored keys at `times` (in frames).

        Between keys, translation and scale are interpolated linearly and rotation along the
        shortest arc, relative to the parent where there is one, as glTF and UsdSkel prescribe.
        """
        count = self.n_frames
        frame = np.arange(count)[:, None]
        before = np.maximum.accumulate(np.where(self.keys, frame, -1), axis=0)
        after = np.minimum.accumulate(np.where(self.keys, frame, count)[::-1], axis=0)[::-1]
        times = np.clip(np.asarray(times, dtype=np.float64), 0, count - 1)
        a = before[np.floor(times).astype(int)]
        b = after[np.ceil(times).astype(int)]
        a, b = np.where(a < 0, b, a), np.where(b >= count, a, b)
        share = np.where(b > a, (times[:, None] - a) / np.maximum(b - a, 1), 0.0)
        bone = np.arange(self.n_bones)[None]
        rotation = matrix_from_quaternion(
            interpolate_quaternions(self.rotations[a, bone], self.rotations[b, bone], share)
        )
        u = share[..., None]
        moved = (1 - u) * self.translations[a, bone] + u * self.translations[b, bone]
        if self.scales is not None:
            scale = (1 - share) * self.scales[a, bone] + share * self.scales[b, bone]
            rotation = rotation * scale[..., None, None]
        if self.parents is not None:
            frames = to_world(np.concatenate([rotation, moved[..., None]], axis=-1), self.parents)
            if self.axes is not None:
                frames[..., :3] = frames[..., :3] @ np.swapaxes(self.axes, 1, 2)
            return from_frames(frames, self.centers)
        shift = moved - np.einsum("fbij,bj->fbi", rotation, self.centers.astype(np.float64))
        return np.concatenate([rotation, shift[..., None]], axis=-1)

    def error(self, model: Skinning, *, between: bool = False) -> tuple[float | None, float | None]:
        """Root mean square and largest distance of vertices between this rig and `model`.

        What is stored is skinned again in float64. Both are None where there is nothing to compare.

        Parameters
        ----------
        model : Skinning
        between : bool
            Midway between frames, against the mean of the two frames of the model: what an engine
            shows there. The path of a turning vertex is curved and the mean lies on its chord, so
            a part of this number is the motion itself; it falls with the square of the frame time.
        """
        rest, weights = self.rest.astype(np.float64), weight_values(self.weights)
        error = StorageError()
        for clip in self.clips:
            # nothing is between two clips
            for block in frame_blocks(clip.start, clip.stop - between, len(rest)):
                times = np.arange(block.start, block.stop) + 0.5 * between
                stored = skin(rest, self.indices, weights, self.matrices(times))
                truth = model.skin(slice(block.start, block.stop + between), dtype=np.float64)
                error.add(stored, (truth[1:] + truth[:-1]) / 2 if between else truth)
        return error.rmse, error.largest

    def report(self, model: Skinning, **fields: Any) -> SaveReport:
        """A report with the errors and influences of what is stored, and further `fields`."""
        rmse, largest = self.error(model)
        return SaveReport(
            influences=self.indices.shape[1],
            error=rmse,
            max_error=largest,
            between_frames=self.error(model, between=True)[0],
            **fields,
        )


def build_rig(
    skinning: Skinning,
    *,
    influences: int | None = None,
    most: int | None = None,
    storage: WeightStorage = "float32",
) -> Rig:
    """Rig of a skinning: the joints of its hierarchy, else joints at the centroids of the bones.

    Parameters
    ----------
    skinning : Skinning
    influences : int, optional
        How many of the largest weights of a vertex to keep.
    most : int, optional
        How many the format can hold.
    storage : {"float32", "uint16", "uint8"}
        How weights are stored.

    Raises
    ------
    InputError
        If there are more influences than `most`, a bone is not a scaled rotation, or numbers are
        too large for float32.
    """
    if influences is not None:
        skinning = skinning.prune(influences)
    indices, weights = quantise(*_sorted_weights(skinning), storage)
    if most is not None and indices.shape[1] > most:
        raise InputError(
            "influences",
            f"at most {most} influences of a vertex; influences={most} prunes the smallest",
            indices.shape[1],
        )
    parents, transforms = skinning.parents, np.asarray(skinning.transforms, dtype=np.float64)
    scales = _scales_of(transforms[..., :3])
    scaled = skinning.bone_model != "rigid" and np.abs(scales - 1).max() >= 1e-6
    at = skinning.centroids() if parents is None else skinning.joint_positions
    centers = np.asarray(at, dtype=np.float32)
    local = transforms.copy()
    local[..., 3] += np.einsum("fbij,bj->fbi", transforms[..., :3], centers.astype(np.float64))
    largest = max(float(np.abs(local[..., 3]).max()), float(np.abs(skinning.rest).max()))
    if largest > 1e30:
        raise InputError("thing", "coordinates that float32 can hold", f"{largest:g}")
    offsets, moving = centers, np.ones(len(centers), dtype=bool)
    if parents is not None:
        local = to_local(transforms, parents, skinning.joint_positions)
        moving = translating(
            transforms, parents, skinning.joint_positions, rest_diagonal(skinning.rest)
        )
        # In float32, a bind matrix and a node differ in their last bits; the mean of all frames
        # takes neither.
        steady = np.where(moving[:, None], rest_offsets(parents, at), local[..., 3].mean(axis=0))
        offsets = steady.astype(np.float32)
        local[..., 3] = np.where(moving[:, None], local[..., 3], offsets)
    linear, sizes = local[..., :3], None
    if scaled:
        sizes = np.cbrt(np.linalg.det(linear))
        linear = linear / sizes[..., None, None]
    rotations = quaternion_from_matrix(linear)
    return Rig(
        rest=skinning.rest.astype(np.float32),
        indices=indices,
        weights=weights,
        centers=centers,
        rotations=unflip_quaternions(rotations).astype(np.float32),
        translations=local[..., 3].astype(np.float32),
        scales=None if sizes is None else sizes.astype(np.float32),
        parents=parents,
        offsets=offsets,
        translating=moving,
        keys=_stored_frames(skinning),
        names=unique_names(skinning.names()),
        clips=skinning.clips,
    )


def _sorted_weights(skinning: Skinning) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    matrix = skinning.sparse_weights().astype(np.float64).tocoo()
    indices, weights = weight_rows(matrix.row, matrix.col, matrix.data)
    return indices, weights / weights.sum(axis=1, keepdims=True)


def _scales_of(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scales (F, B) of scaled rotations (F, B, 3, 3)."""
    scales = np.cbrt(np.linalg.det(linear))
    rotations = linear / np.where(scales > 0, scales, 1.0)[..., None, None]
    off = np.abs(np.swapaxes(rotations, -1, -2) @ rotations - np.eye(3)).max(axis=(-1, -2))
    off = np.where(scales > 0, off, np.inf)
    if off.max() > 1e-3:
        frame, bone = (int(k) for k in np.unravel_index(int(off.argmax()), off.shape))
        raise InputError(
            "thing",
            "bones that are scaled rotations, all that a node of this format can hold; "
            "save the vertices instead, as MeshSequence(skinning.skin(), skinning.faces)",
            f"a shear or reflection (bone {bone}, frame {frame})",
        )
    return np.asarray(scales)


def _stored_frames(skinning: Skinning) -> NDArray[np.bool_]:
    """Keys (F, B): every frame, or the keyframes and the ends of several clips."""
    if skinning.keyframes is None:
        return np.ones(skinning.transforms.shape[:2], dtype=bool)
    keys: NDArray[np.bool_] = skinning.keyframes.copy()
    bare = ~keys.any(axis=0)
    if bare.any():
        raise InputError("keyframes", "a key for every bone", f"none for bone {int(bare.argmax())}")
    if len(skinning.clips) > 1:  # each is played without the others
        for clip in skinning.clips:
            keys[[clip.start, clip.stop - 1]] = True
    return keys


def interpolate_quaternions(
    a: NDArray[Any], b: NDArray[Any], u: NDArray[np.float64]
) -> NDArray[np.float64]:
    """:func:`slerp` of quaternions ``(..., 4)`` that need not have unit length."""
    p, q = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (a.astype(float), b))
    return slerp(p, q, u)


def quantise(
    indices: NDArray[np.int32], weights: NDArray[np.float64], storage: WeightStorage
) -> tuple[NDArray[np.int32], NDArray[Any]]:
    """Weights as a file stores them, in steps that sum to exactly 1.

    Returns
    -------
    indices : (V, K) int32
        0 where the stored weight is 0, as glTF asks.
    stored : (V, K) float32, uint16 or uint8

    Raises
    ------
    InputError
        If `storage` is unknown.
    """
    check_choice(storage, "weights", WeightStorage)
    stored: NDArray[Any] = weights.astype(np.float32)
    if storage == "float32":
        stored[:, 0] = 1.0 - stored[:, 1:].sum(axis=1, dtype=np.float64)
    else:
        steps = np.iinfo(storage).max
        scaled = weights * steps
        whole = np.floor(scaled)
        # Largest remainders: the rounding whose rows keep their sum with the least error.
        order = np.argsort(-np.where(weights > 0, scaled - whole, -1.0), axis=1, kind="stable")
        rank = np.argsort(order, axis=1, kind="stable")
        whole += rank < np.rint(steps - whole.sum(axis=1))[:, None]
        stored = whole.astype(storage)
    return np.where(stored > 0, indices, 0).astype(np.int32), stored


def weight_values(stored: NDArray[Any]) -> NDArray[np.float64]:
    """Weights as float64, from stored ones."""
    steps = np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1
    return np.asarray(stored / np.float64(steps))


def frame_rate(times: Sequence[NDArray[np.float64]]) -> float | None:
    """Frames per second that key times in seconds imply; None if they imply none.

    The rate on whose frames all keys lie: that of the closest two keys, else the lowest usual
    rate. Sparse keys say little, so rates below 10 do not count.
    """
    stamps = np.unique(np.concatenate([np.zeros(0), *times]))
    if len(stamps) < 2:
        return None
    gaps = np.diff(stamps)
    gaps = gaps[gaps > 1e-4]
    if not len(gaps):
        return None
    span = float(stamps[-1] - stamps[0])
    shortest = float(gaps.min())
    closest = round(span / shortest) / span
    nearest = float(round(closest))
    if nearest and abs(closest - nearest) < 1e-4 * nearest:
        closest = nearest
    for rate in (closest, *_RATES):
        ticks = (stamps - stamps[0]) * rate
        if 10 <= rate <= 1000 and np.abs(ticks - np.rint(ticks)).max() < 0.01:
            return rate
    return None
