"""Size of a model in bytes, at the precision that engines store."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError
from .shapes import Shapes, Skinned, skinning_and_shapes
from .skinning import Skinning, skinning_in
from .transforms import rest_diagonal, translating

# In float32: rotation and translation; also a scale; two rotations, translation and three scales.
_KEY_BYTES = {"rigid": 28, "similarity": 32, "affine": 56}
_TRANSLATION_BYTES = 12


@dataclasses.dataclass(frozen=True)
class Size:
    """Bytes of a model at the precision that engines store.

    Attributes
    ----------
    rest : int
        Bytes of the rest pose: 12 per vertex (three float32).
    weights : int
        Bytes of the weights: 1 per vertex for the number of its influences, and per influence 2 for
        a weight of 16 bits and 1 for the bone's index (2 if there are more than 256 bones).
    joints : int
        Bytes of the joints: 12 per bone for its position in the rest pose, and in a hierarchy 1 for
        its parent (2 if there are more than 256 bones).
    keys : int
        Bytes of the keys: 28 per key of a rigid bone (rotation 16, translation 12, in float32), 32
        of a similarity bone, and 56 of an affine bone, which engines play as two nodes.  A key has
        12 bytes less if the bone does not translate relative to its parent or, for a root, does not
        translate at all.  It has 2 more (4 if there are more than 65,536 frames) for its frame
        index, unless the bone has a key at every frame.
    shapes : int
        Bytes of shapes: 12 per displaced vertex (three float32), and 2 for its index (4 if there
        are more than 65,536 vertices) in a shape that does not displace all; 4 per amount, and 2
        (4) for its frame index where other amounts of the shape are 0.

    Examples
    --------
    >>> ssdr.parsimony.Size(rest=1200, weights=400, joints=48, keys=112).total
    1760
    """

    rest: int
    weights: int
    joints: int
    keys: int
    shapes: int = 0

    @property
    def total(self) -> int:
        return self.rest + self.weights + self.joints + self.keys + self.shapes


def size(model: Skinned) -> Size:
    """Bytes of a model: rest pose, nonzero weights, joints, and keys.

    Parameters
    ----------
    model : Skinning or ShapedSkinning, or a result that has one
        If its `keyframes` are None, every frame is a key of every bone.

    Returns
    -------
    Size

    Raises
    ------
    InputError
        If an argument is not usable.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> size = ssdr.parsimony.size(ssdr.initialize(dancer, bones=4))
    >>> size.rest == 12 * 799, size.joints == 12 * 4
    (True, True)
    """
    found = skinning_in(model)
    if not isinstance(found, Skinned):
        raise InputError("model", "a Skinning", type(model).__name__)
    skinning, shapes = skinning_and_shapes(found)
    frames, bones = skinning.transforms.shape[:2]
    keys = np.full(bones, frames)
    if skinning.keyframes is not None:
        keys = np.asarray(skinning.keyframes).sum(axis=0)
    influence = influence_bytes(bones)
    parent = index_bytes(bones) if skinning.parents is not None else 0
    times = np.where(keys < frames, keys * time_bytes(frames), 0)
    return Size(
        rest=12 * skinning.n_vertices,
        weights=skinning.n_vertices + influence * int(np.count_nonzero(skinning.weights)),
        joints=(12 + parent) * bones,
        keys=int((keys * key_bytes(skinning) + times).sum()),
        shapes=0 if shapes is None else _shape_bytes(shapes),
    )


def _shape_bytes(shapes: Shapes) -> int:
    """Number of bytes that the shapes' displacements and their amounts in all frames take.

    The values of a shape are stored dense or sparse, whichever takes fewer bytes.
    """
    total = 0
    for values, each in ((shapes.moved.T, 12), (shapes.amounts != 0, 4)):
        used = values.sum(axis=0)
        sparse = used * (each + time_bytes(len(values)))
        total += int(np.minimum(sparse, each * len(values)).sum())
    return total


def influence_bytes(bones: int) -> int:
    """Number of bytes per influence: a weight of 16 bits, and an index."""
    return 2 + index_bytes(bones)


def index_bytes(bones: int) -> int:
    """Number of bytes of a bone index."""
    return 1 if bones <= 256 else 2


def key_bytes(skinning: Skinning) -> NDArray[np.int64]:
    """Number of bytes (B,) that one key of each bone takes."""
    each = np.full(skinning.n_bones, _KEY_BYTES[skinning.bone_model])
    if skinning.parents is None:
        return each
    tree = skinning.parents, skinning.joint_positions
    moving = translating(skinning.transforms, *tree, rest_diagonal(skinning.rest))
    return np.where(moving, each, each - _TRANSLATION_BYTES)


def time_bytes(frames: int) -> int:
    """Number of bytes of a key's frame index in an animation of `frames` frames."""
    return 2 if frames <= 1 << 16 else 4
