"""What a search for the smallest model says: its size in bytes, and what each saving cost."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..hierarchy.transforms import rest_diagonal, translating
from ..skinning import Skinning

__all__ = [
    "KEY_BYTES",
    "Attempt",
    "Parsimony",
    "Pruning",
    "Size",
    "bytes_of",
    "influence_bytes",
    "key_bytes",
    "size",
    "time_bytes",
]


@dataclasses.dataclass(frozen=True)
class Attempt:
    """One try: bones, the error that it reached, steps that it took, where it started.

    Examples
    --------
    >>> attempt = ssdr.parsimony.Attempt(bones=4, error=0.25, iterations=6, start="merged")
    >>> attempt.bones, attempt.iterations
    (4, 6)
    """

    bones: int
    error: float
    iterations: int
    start: str


@dataclasses.dataclass(frozen=True)
class Size:
    """Bytes of a model at the precision that engines store.

    Attributes
    ----------
    rest : int
        12 a vertex: three float32.
    weights : int
        A vertex: 1 for the number of its influences; for each of them 2 of
        weight (16 bits) and 1 of index (2 beyond 256 bones).
    joints : int
        12 a bone: its place in the rest pose.  In a hierarchy 1 more for its
        parent (2 beyond 256 bones).
    keys : int
        A key: rotation 16 and translation 12 (float32), 4 more for a scale;
        48 for an affine bone.  A joint that does not translate against its
        parent, and a root that stays, need no translation: 12 less.  A bone
        without a key at every frame stores the frame of each as well: 2 (4 beyond
        65,536 frames).

    Examples
    --------
    >>> ssdr.parsimony.Size(rest=1200, weights=400, joints=48, keys=112).total
    1760
    """

    rest: int
    weights: int
    joints: int
    keys: int

    @property
    def total(self) -> int:
        return self.rest + self.weights + self.joints + self.keys


@dataclasses.dataclass(frozen=True)
class Pruning:
    """What was left out, and what that cost.

    Attributes
    ----------
    what : {"bones", "influences", "keyframes"}
    before, after : int
        Bones; influences of all vertices; keys of all bones.
    bytes_before, bytes_after : int
    error_before, error_after : float
        In the mesh's units, as the tolerance means it.

    Examples
    --------
    >>> pruning = ssdr.parsimony.Pruning("bones", 8, 6, 4000, 3500, 0.25, 0.5)
    >>> pruning.before - pruning.after, pruning.cost
    (2, 0.25)
    """

    what: Literal["bones", "influences", "keyframes"]
    before: int
    after: int
    bytes_before: int
    bytes_after: int
    error_before: float
    error_after: float

    @property
    def cost(self) -> float:
        """Error that the pruning added, in the mesh's units (below 0: what a new solve gained)."""
        return self.error_after - self.error_before


@dataclasses.dataclass(frozen=True)
class Parsimony:
    """How small a model a tolerance allows.

    Attributes
    ----------
    tolerance : float
        In the mesh's units.
    tolerance_of : {"rmse", "max"}
    error : float
        What the result reaches, measured on the frames.
    held : bool
        Whether that is within the tolerance.
    bones, influences : int
        Of the result; `influences` is the most that a vertex has.
    least_bones : int
        No model of fewer holds the tolerance: proven by the rank of the motion.
    size : Size
    prunings : tuple of Pruning
        Bones, influences, keyframes, in this order; after a stop those that were done.
    attempts : tuple of Attempt
        Everything that was tried: bones, error, iterations, where it started.

    Examples
    --------
    >>> points = np.random.default_rng(0).random((8, 3))
    >>> turn = np.diag([-1.0, -1.0, 1.0])
    >>> frames = np.stack([points, points @ turn, points + 1])
    >>> result = ssdr.decompose(frames, tolerance="0.5%", effort="fast", bones=2)
    >>> result.parsimony.held, result.parsimony.bones
    (True, 1)
    """

    tolerance: float
    tolerance_of: Literal["rmse", "max"]
    error: float
    held: bool
    bones: int
    influences: int
    least_bones: int
    size: Size
    prunings: tuple[Pruning, ...]
    attempts: tuple[Attempt, ...]


def size(skinning: Skinning) -> Size:
    """Bytes of a model: rest pose, weights that are not zero, joints, keys.

    Parameters
    ----------
    skinning : Skinning
        Where `keyframes` is None every frame is a key of every bone.

    Returns
    -------
    Size

    Raises
    ------
    InputError
        If it is no Skinning.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> size = ssdr.parsimony.size(ssdr.initialize(dancer, bones=4))
    >>> size.rest == 12 * 799, size.joints == 12 * 4
    (True, True)
    """
    if not isinstance(skinning, Skinning):
        raise InputError("skinning", "a Skinning", type(skinning).__name__)
    frames, bones = skinning.transforms.shape[:2]
    keys = np.full(bones, frames)
    if skinning.keyframes is not None:
        keys = np.asarray(skinning.keyframes).sum(axis=0)
    used = int(np.count_nonzero(skinning.weights))
    return bytes_of(
        skinning.n_vertices,
        used,
        frames,
        keys,
        skinning.bone_model,
        key_bytes=key_bytes(skinning),
        tree=skinning.parents is not None,
    )


def influence_bytes(bones: int) -> int:
    """Of one influence of a vertex: 16 bits of weight and an index."""
    return 3 if bones <= 256 else 4


def key_bytes(skinning: Skinning) -> int | NDArray[np.int64]:
    """Bytes of a key: of any bone, in a hierarchy of each (B,)."""
    whole = KEY_BYTES[skinning.bone_model]
    if skinning.parents is None:
        return whole
    tree = skinning.parents, skinning.joint_positions
    moving = translating(skinning.transforms, *tree, rest_diagonal(skinning.rest))
    return np.where(moving, whole, whole - TRANSLATION_BYTES)


def bytes_of(
    vertices: int,
    used: int,
    frames: int,
    keys: NDArray[Any],
    bone_model: str,
    *,
    key_bytes: int | NDArray[np.int64] | None = None,
    tree: bool = False,
) -> Size:
    """The same from counts: influences that are used, and keys (B,) of each bone.

    `key_bytes` are those of :func:`key_bytes`, of bones without a hierarchy by default; in a
    `tree` each bone has a parent as well.
    """
    each = KEY_BYTES[bone_model] if key_bytes is None else key_bytes
    stored = keys * each + np.where(keys < frames, keys * time_bytes(frames), 0)
    above = (influence_bytes(len(keys)) - 2) if tree else 0
    return Size(
        rest=12 * vertices,
        weights=vertices + used * influence_bytes(len(keys)),
        joints=(12 + above) * len(keys),
        keys=int(stored.sum()),
    )


# float32: rotation and translation; a scale as well; a matrix
KEY_BYTES = {"rigid": 28, "similarity": 32, "affine": 48}
TRANSLATION_BYTES = 12


def time_bytes(frames: int) -> int:
    """Of the frame of a key."""
    return 2 if frames <= 1 << 16 else 4
