"""A model as engines play it: joints with keyframes, and skin weights.

Keyframes and weights are rounded as a file stores them, and the error of the rounding is measured.

If the model has a hierarchy, its joints are stored, with transforms relative to their parents. If
it has none, each bone gets a joint at the centroid of the vertices that it moves. The reason is
that engines interpolate translation and rotation separately: between two keys of a rotation about a
far origin, they would move the vertices along a chord instead of an arc.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError, check_choice
from ..mesh.clips import Clip, unique_names
from ..model.lbs import skin, skin_each
from ..model.rigid import matrix_from_quaternion, quaternion_from_matrix, slerp, unflip_quaternions
from ..model.shapes import Shapes, Skinned, skinning_and_shapes
from ..model.skinning import Skinning
from ..model.stretch import steady_axes
from ..model.transforms import (
    from_frames,
    rest_diagonal,
    rest_offsets,
    to_local,
    to_world,
    translating,
)
from .save_report import Rounding, SaveReport, frame_blocks

WeightStorage = Literal["float32", "uint16", "uint8"]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PlayedModel:
    """A skinning as a skeleton of joints, rounded as a file stores it.

    Rotations, translations and scales of a joint are relative to its parent; those of a root, and
    of every joint if there is no hierarchy, are relative to the world.

    Attributes
    ----------
    rest : (V, 3) float32
    indices : (V, K) int32
    weights : (V, K) float32, uint16 or uint8
        As stored; integers count steps of 1/65535 (uint16) or 1/255 (uint8). Each row descends and
        has no bone twice.
    centers : (B, 3) float32
        Joints in the rest pose.
    rotations : (F, B, 4) float32
        Unit quaternions xyzw, whose signs do not flip between consecutive frames.
    translations : (F, B, 3) float32
        Position of each joint.
    scales : (F, B, 3) float32 or None
        Factors along the axes of each joint; None if every one is 1.
    parents : (B,) int32 or None
        -1 at roots; None without a hierarchy.
    offsets : (B, 3) float32
        Position of each joint in the rest pose, relative to its parent. A joint that does not
        translate has this position in every frame.
    translating : (B,) bool
        True for the joints whose `translations` are stored.
    keys : (F, B) bool
        True where the transform of a joint in a frame is stored.
    names : tuple of str
    clips : tuple of Clip
    shapes : Shapes or None
        Shapes of the rest pose, with the amounts of every frame.
    moving : (D,) int or None
        Indices of the joints that move vertices, into which `indices` point; None if all joints do.
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
    shapes: Shapes | None = None
    moving: NDArray[np.int64] | None = None

    @property
    def n_frames(self) -> int:
        return len(self.rotations)

    @property
    def n_bones(self) -> int:
        return len(self.centers)

    def matrices(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transforms ``(n, B, 3, 4)`` of the bones at n `times` (in frames), from the stored keys.

        Between keys, the translation and scale relative to the parent are interpolated linearly,
        and the rotation along the shortest arc, as glTF and UsdSkel prescribe.
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
            scale = (1 - u) * self.scales[a, bone] + u * self.scales[b, bone]
            rotation = rotation * scale[..., None, :]
        if self.parents is not None:
            frames = to_world(np.concatenate([rotation, moved[..., None]], axis=-1), self.parents)
            return from_frames(frames, self.centers)
        shift = moved - np.einsum("fbij,bj->fbi", rotation, self.centers.astype(np.float64))
        return np.concatenate([rotation, shift[..., None]], axis=-1)

    def skin(self, times: NDArray[np.float64]) -> NDArray[np.floating]:
        """Vertices ``(n, V, 3)`` at n `times` (in frames), from the stored arrays in float64."""
        rest, moves = self.rest.astype(np.float64), self.matrices(times)
        moves = moves if self.moving is None else moves[:, self.moving]
        skinned = self.indices, weight_values(self.weights)
        if self.shapes is None:
            return skin(rest, *skinned, moves)
        before, after = (self.shapes.added(x(times).astype(int)) for x in (np.floor, np.ceil))
        share = (times - np.floor(times))[:, None, None]
        return skin_each(rest + (1 - share) * before + share * after, *skinned, moves)

    def error(self, model: Skinned, *, between: bool = False) -> tuple[float, float]:
        """Root mean square and largest distance between the vertices of this model and of `model`.

        The stored arrays are skinned in float64. Both numbers are 0 if there are no frames to
        compare.

        Parameters
        ----------
        model : Skinning or ShapedSkinning
        between : bool
            Compare halfway between consecutive frames, where engines interpolate, with the mean of
            the model's vertices in the two frames. A rotating vertex moves on an arc, but this mean
            lies on its chord, so a part of the distance is no error of the file; this part falls
            with the square of the frame time.
        """
        error = Rounding()
        for clip in self.clips:
            # nothing is between two clips
            for block in frame_blocks(clip.start, clip.stop - between, len(self.rest)):
                times = np.arange(block.start, block.stop) + 0.5 * between
                stored = self.skin(times)
                truth = model.skin(slice(block.start, block.stop + between), dtype=np.float64)
                error.add(stored, (truth[1:] + truth[:-1]) / 2 if between else truth)
        return error.rmse, error.largest

    def report(self, model: Skinned, **fields: Any) -> SaveReport:
        """Report on saving `model` as this one: its errors, and further `fields`."""
        rmse, largest = self.error(model)
        return SaveReport(
            error=rmse,
            max_error=largest,
            between_frames=self.error(model, between=True)[0],
            **fields,
        )


def as_played(
    model: Skinned,
    *,
    most: int | None = None,
    storage: WeightStorage = "float32",
    stretch: bool = False,
) -> PlayedModel:
    """Model whose joints are those of the skinning's hierarchy or, without one, bone centroids.

    A bone M = U S Vᵀ that stretches becomes two joints: one that rotates by U and scales by S, with
    "_stretch" after the bone's name, and below it one with the bone's name, which rotates by Vᵀ.

    Parameters
    ----------
    model : Skinning or ShapedSkinning
    most : int, optional
        Largest number of weights for each vertex that the format can hold.
    storage : {"float32", "uint16", "uint8"}
        Type in which weights are stored.
    stretch : bool
        Whether the format plays scales along the axes of a joint, so that bones may stretch.

    Raises
    ------
    InputError
        If a vertex has more than `most` weights, a bone stretches and may not, or mirrors, or
        coordinates are too large for float32.
    """
    skinning, shapes = skinning_and_shapes(model)
    indices, weights = quantise(*_sorted_weights(skinning), storage)
    if most is not None and indices.shape[1] > most:
        raise InputError(
            "influences",
            f"at most {most} influences of a vertex; thing.prune({most}) drops the smallest",
            indices.shape[1],
        )
    parents, transforms = skinning.parents, np.asarray(skinning.transforms, dtype=np.float64)
    kind = skinning.bone_model
    # what calls itself rigid may be off by rounding, but a scale that would be seen is kept
    rounding = 1e-3 if kind == "rigid" else 1e-6
    scales, off = _scales_of(transforms[..., :3])
    stretched = off.max() > (1e-6 if stretch and kind == "affine" else 1e-3)
    if (stretched and not stretch) or (scales <= 0).any():
        _refuse_stretch(off)
    scaled = np.abs(scales - 1).max() >= rounding
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
        # After rounding to float32, a file's bind matrices and nodes differ in their last bits;
        # the mean over all frames prefers neither.
        steady = np.where(moving[:, None], rest_offsets(parents, at), local[..., 3].mean(axis=0))
        offsets = steady.astype(np.float32)
        local[..., 3] = np.where(moving[:, None], local[..., 3], offsets)
    linear, sizes, within = local[..., :3], None, None
    if stretched:
        linear, sizes, within = steady_axes(linear)
    elif scaled:
        sizes = np.repeat(np.cbrt(np.linalg.det(linear))[..., None], 3, axis=2)
        linear = linear / sizes[..., None]
    rotations = quaternion_from_matrix(linear)
    played = PlayedModel(
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
        shapes=None if shapes is None else _in_float32(shapes),
    )
    return played if within is None else _with_inner(played, within)


def _with_inner(played: PlayedModel, within: NDArray[np.float64]) -> PlayedModel:
    """Model in which each joint has a second one below it, turned by `within` (F, B, 3, 3).

    The second joint moves the vertices.  The first joint of a bone is a child of the second joint
    of its parent bone.
    """
    count, above = played.n_bones, -1 if played.parents is None else played.parents
    own = np.arange(count, dtype=np.int32)
    turns = unflip_quaternions(quaternion_from_matrix(within)).astype(np.float32)

    def both(first: NDArray[Any], second: Any, axis: int = 1) -> NDArray[Any]:
        return np.concatenate([first, np.broadcast_to(second, first.shape)], axis=axis)

    assert played.scales is not None
    return dataclasses.replace(
        played,
        centers=both(played.centers, played.centers, 0),
        rotations=both(played.rotations, turns),
        translations=both(played.translations, np.float32(0)),
        scales=both(played.scales, np.float32(1)),
        parents=np.concatenate([np.where(above + 0 * own >= 0, above + count, -1), own]),
        offsets=both(played.offsets, np.float32(0), 0),
        translating=both(played.translating, False, 0),
        keys=both(played.keys, played.keys),
        names=unique_names([*(f"{name}_stretch" for name in played.names), *played.names]),
        moving=own.astype(np.int64) + count,
    )


def _in_float32(shapes: Shapes) -> Shapes:
    moved, amounts = (x.astype(np.float32) for x in (shapes.displacements, shapes.amounts))
    return Shapes(moved, amounts, names=shapes.names)


def _sorted_weights(skinning: Skinning) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Indices and weights (V, K) with sum 1, largest weight first, and no bone twice in a row."""
    matrix = skinning.sparse_weights().astype(np.float64).tocoo()
    order = np.lexsort((matrix.col, -matrix.data, matrix.row))
    count = np.bincount(matrix.row)
    row, start = matrix.row[order], np.cumsum(count) - count
    place = np.arange(len(order)) - start[row]
    indices = np.zeros((len(count), count.max()), dtype=np.int32)
    weights = np.zeros(indices.shape)
    indices[row, place], weights[row, place] = matrix.col[order], matrix.data[order]
    return indices, weights / weights.sum(axis=1, keepdims=True)


def quantise(
    indices: NDArray[np.int32], weights: NDArray[np.float64], storage: WeightStorage
) -> tuple[NDArray[np.int32], NDArray[Any]]:
    """Round weights as a file stores them, so that those of a vertex sum to exactly 1.

    Returns
    -------
    indices : (V, K) int32
        As given, but 0 where the stored weight is 0, as glTF requires.
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
        # The largest remainders are rounded up: rows keep their sum with the least error.
        order = np.argsort(-np.where(weights > 0, scaled - whole, -1.0), axis=1, kind="stable")
        rank = np.argsort(order, axis=1, kind="stable")
        whole += rank < np.rint(steps - whole.sum(axis=1))[:, None]
        stored = whole.astype(storage)
    return np.where(stored > 0, indices, 0).astype(np.int32), stored


def weight_values(stored: NDArray[Any]) -> NDArray[np.float64]:
    """Weights in float64 from stored weights; integers are divided by the maximum of their type."""
    steps = np.iinfo(stored.dtype).max if stored.dtype.kind == "u" else 1
    return np.asarray(stored / np.float64(steps))


def _scales_of(linear: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Scale (F, B) of each matrix (F, B, 3, 3), and its deviation (F, B) from a scaled rotation.

    The deviation is inf where a matrix mirrors.
    """
    scales = np.cbrt(np.linalg.det(linear))
    rotations = linear / np.where(scales > 0, scales, 1.0)[..., None, None]
    off = np.abs(np.swapaxes(rotations, -1, -2) @ rotations - np.eye(3)).max(axis=(-1, -2))
    return scales, np.where(scales > 0, off, np.inf)


def _refuse_stretch(off: NDArray[np.float64]) -> None:
    frame, bone = (int(k) for k in np.unravel_index(int(off.argmax()), off.shape))
    raise InputError(
        "thing",
        "bones that are scaled rotations, all that a node of this format can hold; "
        "save the vertices instead, as MeshSequence(skinning.skin(), skinning.faces)",
        f"a shear or reflection (bone {bone}, frame {frame})",
    )


def _stored_frames(skinning: Skinning) -> NDArray[np.bool_]:
    """Mask (F, B) of the stored keys: the model's keyframes, or every frame if it has none.

    If a model with keyframes has several clips, the first and last frame of each clip are stored,
    too.
    """
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
    """Interpolate quaternions ``(..., 4)`` by :func:`slerp`, after scaling them to unit norm."""
    p, q = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in (a.astype(float), b))
    return slerp(p, q, u)
