"""What formats with a skeleton share: joints, keys, stored weights, and what storing costs.

Where bones have a hierarchy, their joints and local transforms are what is
stored.  A bone without one has no joint of its own.  It gets one at the centroid
of what it moves, so that an engine that interpolates translation and rotation
between two keys stays near the surface: a rotation about a far origin would
sweep the bone along a chord.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..clips import Clip, unique_names
from ..errors import FormatError, InputError, check_choice
from ..hierarchy.transforms import (
    from_frames,
    rest_diagonal,
    rest_offsets,
    to_local,
    to_world,
    translating,
)
from ..rigid import matrix_from_quaternion, quaternion_from_matrix, slerp, unflip_quaternions
from ..skinning import BoneModel, Skinning, skin

__all__ = [
    "MAX_BYTES",
    "Error",
    "Rig",
    "WeightStorage",
    "build_rig",
    "check_size",
    "frame_rate",
    "interpolate_quaternions",
    "join_trees",
    "model_of",
    "quantise",
    "unique_names",
]

WeightStorage = Literal["float32", "uint16", "uint8"]

MAX_BYTES = 16 << 30  # 16 GiB that a file's counts may ask for unless the caller allows more
_CHUNK_BYTES = 64 << 20  # bytes of float64 positions skinned at a time: more takes more memory
# frames per second in use in film, television and motion capture
_RATES = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 100.0, 120.0)


@dataclasses.dataclass(frozen=True)
class Error:
    """Root mean square and largest distance of a vertex; None where nothing was measured."""

    rmse: float | None
    largest: float | None


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Rig:
    """A skinning as a skeleton of joints, in the precision of its storage.

    What moves a joint is relative to its parent's frame, at a root and where there is no
    hierarchy to the world.

    Attributes
    ----------
    rest : (V, 3) float32
    indices : (V, K) int32
    weights : (V, K) float64
        Descending, no joint twice, summing to 1.
    centers : (B, 3) float32
        Joints in the rest pose, where their axes are the world's.
    rotations : (F, B, 4) float32
        Unit quaternions xyzw whose sign never flips from a frame to the next.
    translations : (F, B, 3) float32
        Position of each joint.
    scales : (F, B) float32 or None
        None: all are 1.
    parents : (B,) int32 or None
        -1 at roots; None without a hierarchy.
    offsets : (B, 3) float32
        Position of each joint where nothing moves it; the only one of a joint that does not
        translate.
    translating : (B,) bool
        Whose `translations` are stored.
    keys : (F, B) bool
        Frames that are stored.
    names : tuple of str
    clips : tuple of Clip
    axes : (B, 3, 3) float64 or None
        With a hierarchy: how each joint is turned in the rest pose; None: all as the world.
    """

    rest: NDArray[np.float32]
    indices: NDArray[np.int32]
    weights: NDArray[np.float64]
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

        Between keys translation and scale are interpolated linearly, rotation
        along the shortest arc, as glTF and UsdSkel prescribe: relative to the
        parent, where there is one.
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

    def error(
        self, model: Skinning, *, weights: NDArray[Any] | None = None, between: bool = False
    ) -> Error:
        """Distance of what is stored, re-skinned in float64, from what `model` gives.

        Parameters
        ----------
        model : Skinning
        weights : (V, K) array, optional
            Weights as stored; those of the rig by default.
        between : bool
            Midway between frames, against the mean of the two frames of the
            model: what an engine shows there.  The path of a turning vertex is
            curved, the mean lies on its chord, so a part of this number is the
            motion itself; it falls with the square of the frame time.
        """
        shown = self.weights if weights is None else np.asarray(weights, dtype=np.float64)
        rest = self.rest.astype(np.float64)
        count = self.n_frames - len(self.clips) if between else self.n_frames
        if count < 1:
            return Error(None, None)
        step = max(1, _CHUNK_BYTES // (len(rest) * 24))
        total, largest = 0.0, 0.0
        for clip in self.clips:
            stop = clip.stop - between  # nothing is between two clips
            for first in range(clip.start, stop, step):
                last = min(first + step, stop)
                times = np.arange(first, last, dtype=np.float64) + 0.5 * between
                stored = skin(rest, self.indices, shown, self.matrices(times))
                truth = model.skin(slice(first, last + between), dtype=np.float64)
                if between:
                    truth = (truth[1:] + truth[:-1]) / 2
                squares = ((stored - truth) ** 2).sum(axis=2)
                total += float(squares.sum())
                largest = max(largest, float(squares.max()))
        return Error(math.sqrt(total / (count * len(rest))), math.sqrt(largest))


def build_rig(skinning: Skinning, *, influences: int | None = None, most: int | None = None) -> Rig:
    """Joints of the hierarchy, else at the centroids of what bones move; sorted weights.

    Parameters
    ----------
    skinning : Skinning
    influences : int, optional
        Keep so many of the largest weights of a vertex.
    most : int, optional
        What the format can hold.

    Raises
    ------
    InputError
        If there are more influences than `most`, a bone is not a scaled
        rotation, or numbers are too large for float32.
    """
    if influences is not None and (
        isinstance(influences, bool) or int(influences) != influences or influences < 1
    ):
        raise InputError("influences", "an integer >= 1", repr(influences))
    indices, weights = _sorted_weights(skinning, influences)
    if most is not None and indices.shape[1] > most:
        raise InputError(
            "influences",
            f"at most {most} influences of a vertex; influences={most} prunes the smallest",
            indices.shape[1],
        )
    rotation, scale = _scaled_rotations(skinning)
    parents = skinning.parents
    at = skinning.centroids() if parents is None else skinning.joint_positions
    centers = np.asarray(at, dtype=np.float32)
    linear = np.asarray(skinning.transforms[..., :3], dtype=np.float64)
    moved = np.einsum("fbij,bj->fbi", linear, centers.astype(np.float64))
    moved += skinning.transforms[..., 3]
    largest = max(float(np.abs(moved).max()), float(np.abs(skinning.rest).max()))
    if largest > 1e30:
        raise InputError("thing", "coordinates that float32 can hold", f"{largest:g}")
    keys = skinning.keyframes
    if keys is None:
        keys = np.ones(skinning.transforms.shape[:2], dtype=bool)
    offsets, moving = centers, np.ones(len(centers), dtype=bool)
    if parents is not None:
        local = to_local(skinning.transforms, parents, skinning.joint_positions)
        moving = translating(
            skinning.transforms, parents, skinning.joint_positions, rest_diagonal(skinning.rest)
        )
        # A bind matrix and a node of float32 differ in their last bits: the mean has neither's.
        steady = np.where(moving[:, None], rest_offsets(parents, at), local[..., 3].mean(axis=0))
        offsets = steady.astype(np.float32)
        moved = np.where(moving[:, None], local[..., 3], offsets)
        rotation = local[..., :3]
        if scale is not None:
            scale = np.cbrt(np.linalg.det(rotation))
            rotation = rotation / scale[..., None, None]
    bare = ~keys.any(axis=0)
    if bare.any():
        raise InputError("keyframes", "a key for every bone", f"none for bone {int(bare.argmax())}")
    if len(skinning.clips) > 1:
        keys = keys.copy()
        for clip in skinning.clips:  # each is played without the others
            keys[[clip.start, clip.stop - 1]] = True
    return Rig(
        rest=skinning.rest.astype(np.float32),
        indices=indices,
        weights=weights,
        centers=centers,
        rotations=unflip_quaternions(quaternion_from_matrix(rotation)).astype(np.float32),
        translations=moved.astype(np.float32),
        scales=None if scale is None else scale.astype(np.float32),
        parents=parents,
        offsets=offsets,
        translating=moving,
        keys=keys,
        names=unique_names(skinning.names()),
        clips=skinning.clips,
    )


def _sorted_weights(
    skinning: Skinning, influences: int | None
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    matrix = skinning.sparse_weights().astype(np.float64)
    row = np.repeat(np.arange(skinning.n_vertices), np.diff(matrix.indptr))
    order = np.lexsort((matrix.indices, -matrix.data, row))
    place = np.arange(len(row)) - matrix.indptr[row]
    width = int(np.diff(matrix.indptr).max())
    if influences is not None:
        width = min(width, int(influences))
    keep = place < width
    indices = np.zeros((skinning.n_vertices, width), dtype=np.int32)
    weights = np.zeros(indices.shape)
    indices[row[keep], place[keep]] = matrix.indices[order][keep]
    weights[row[keep], place[keep]] = matrix.data[order][keep]
    return indices, weights / weights.sum(axis=1, keepdims=True)


def _scaled_rotations(
    skinning: Skinning,
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    linear = np.asarray(skinning.transforms[..., :3], dtype=np.float64)
    scale = np.cbrt(np.linalg.det(linear))
    usable = scale > 0
    rotation = linear / np.where(usable, scale, 1.0)[..., None, None]
    off = np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max(axis=(-1, -2))
    off = np.where(usable, off, np.inf)
    if off.max() > 1e-3:
        frame, bone = (int(k) for k in np.unravel_index(int(off.argmax()), off.shape))
        raise InputError(
            "thing",
            "bones that are scaled rotations, all that a node of this format can hold; "
            "save the vertices instead, as MeshSequence(skinning.skin(), skinning.faces)",
            f"a shear or reflection (bone {bone}, frame {frame})",
        )
    if skinning.bone_model == "rigid" or np.abs(scale - 1).max() < 1e-6:
        return rotation, None
    return rotation, scale


def interpolate_quaternions(
    a: NDArray[Any], b: NDArray[Any], u: NDArray[np.float64]
) -> NDArray[np.float64]:
    """:func:`slerp` of quaternions ``(..., 4)`` of any length but 0, as files hold them."""
    p, q = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (a.astype(float), b))
    return slerp(p, q, u)


def quantise(
    indices: NDArray[np.int32], weights: NDArray[np.float64], storage: WeightStorage
) -> tuple[NDArray[np.int32], NDArray[Any], NDArray[np.float64]]:
    """Weights as stored, summing to exactly 1 in their own steps.

    Returns
    -------
    indices : (V, K) int32
        0 where the stored weight is 0, as glTF asks.
    stored : (V, K) float32, uint16 or uint8
    values : (V, K) float64
        What a reader gets back.

    Raises
    ------
    InputError
        If `storage` is unknown.
    """
    check_choice(storage, "weights", WeightStorage)
    stored: NDArray[Any]
    if storage == "float32":
        stored = weights.astype(np.float32)
        stored[:, 0] = 1.0 - stored[:, 1:].sum(axis=1, dtype=np.float64)
        values = stored.astype(np.float64)
    else:
        steps = np.iinfo(storage).max
        scaled = weights * steps
        whole = np.floor(scaled)
        # Largest remainders: the rounding whose rows keep their sum with the least error.
        order = np.argsort(-np.where(weights > 0, scaled - whole, -1.0), axis=1, kind="stable")
        rank = np.argsort(order, axis=1, kind="stable")
        whole += rank < np.rint(steps - whole.sum(axis=1))[:, None]
        stored = whole.astype(storage)
        values = whole / steps
    return np.where(stored > 0, indices, 0).astype(np.int32), stored, values


def check_size(n_frames: int, n_vertices: int, max_bytes: int) -> None:
    """Refuse to allocate a sequence that a damaged file claims to hold.

    Raises
    ------
    FormatError
        If float32 vertices of that number need more than `max_bytes`.
    """
    need = n_frames * n_vertices * 12
    if need > max_bytes:
        raise FormatError(
            f"{n_frames} frames of {n_vertices} vertices need {need} bytes, max_bytes is "
            f"{max_bytes}; a lower fps or a higher max_bytes admits them"
        )


def model_of(transforms: NDArray[np.float64]) -> BoneModel:
    """The narrowest bone model that holds the transforms to float32 accuracy."""
    linear = transforms[..., :3]
    gram = np.swapaxes(linear, -1, -2) @ linear
    size = np.trace(gram, axis1=-2, axis2=-1) / 3
    off = np.abs(gram - size[..., None, None] * np.eye(3)).max(axis=(-1, -2))
    if (off > 1e-4 * size).any() or (np.linalg.det(linear) <= 0).any():
        return "affine"
    return "rigid" if np.abs(size - 1).max() < 1e-4 else "similarity"


def join_trees(
    trees: Sequence[tuple[NDArray[np.int32], NDArray[np.float64]]],
) -> tuple[NDArray[np.int32] | None, NDArray[np.float64] | None]:
    """Parents and joints of several skeletons as one; None where nothing hangs on anything."""
    starts = np.cumsum([0, *(len(parents) for parents, _ in trees)])
    parents = np.concatenate(
        [np.where(p >= 0, p + k, -1) for (p, _), k in zip(trees, starts[:-1], strict=True)]
    ).astype(np.int32)
    if (parents < 0).all():
        return None, None
    return parents, np.concatenate([positions for _, positions in trees])


def frame_rate(times: Sequence[NDArray[np.float64]]) -> float | None:
    """Frames per second of key times in seconds, None where they tell nothing.

    The rate on whose grid all keys lie: that of the closest two keys, else the
    lowest usual one; sparse keys say little, so rates below 10 do not count.
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
