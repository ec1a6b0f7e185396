"""What a search for the smallest model reports: attempts, savings, and the size in bytes."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..hierarchy.transforms import rest_diagonal, translating
from ..result import Decomposition
from ..skinning import Skinning

__all__ = [
    "Attempt",
    "Measure",
    "Parsimony",
    "Pruning",
    "Size",
    "Smallest",
    "influence_bytes",
    "key_bytes",
    "size",
    "time_bytes",
]

Measure = Literal["rmse", "max"]

# float32: rotation and translation; a scale as well; a matrix
_KEY_BYTES = {"rigid": 28, "similarity": 32, "affine": 48}
_TRANSLATION_BYTES = 12


@dataclasses.dataclass(frozen=True)
class Attempt:
    """One attempt at a number of bones.

    Attributes
    ----------
    bones : int
    error : float
        In the mesh's units, as the tolerance means it.
    iterations : int
        Alternations and polish steps.
    start : str
        What it started from, such as "merged" or "new start".

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
        For each vertex 1 (the number of its influences); for each influence 2 (a weight of
        16 bits) and 1 for the index (2 beyond 256 bones).
    joints : int
        12 a bone: its place in the rest pose.  In a hierarchy 1 more for the parent (2 beyond
        256 bones).
    keys : int
        For each key 28: rotation 16, translation 12 (float32); 32 with a scale, 48 for an affine
        bone.  12 less for a joint that does not translate against its parent, and for a root that
        stays.  2 more (4 beyond 65,536 frames) for the frame of a key where not every frame is a
        key of the bone.

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
    """What was left out of the model, and what that cost.

    Attributes
    ----------
    what : {"bones", "influences", "keyframes"}
    before, after : int
        Number of bones, of influences of all vertices, or of keys of all bones.
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
        """Rise of the error, in the mesh's units; negative where solving anew gained more."""
        return self.error_after - self.error_before


@dataclasses.dataclass(frozen=True)
class Parsimony:
    """How small a model holds the tolerance.

    Attributes
    ----------
    tolerance : float
        In the mesh's units.
    measure : {"rmse", "max"}
    error : float
        Error of the result, measured on the frames.
    held : bool
        True if that is within the tolerance.
    bones, influences : int
        Of the result; `influences` is the most that a vertex has.
    least_bones : int
        No model of fewer bones holds the tolerance: proven by the rank of the motion.
    size : Size
    prunings : tuple of Pruning
        Bones, influences, keyframes, in this order; those that were done before a stop.
    attempts : tuple of Attempt
        Everything that was tried, in order.

    Examples
    --------
    >>> points = np.random.default_rng(0).random((8, 3))
    >>> turn = np.diag([-1.0, -1.0, 1.0])
    >>> frames = np.stack([points, points @ turn, points + 1])
    >>> result = ssdr.smallest(frames, tolerance="0.5%", effort="fast", bones=2)
    >>> result.parsimony.held, result.parsimony.bones
    (True, 1)
    """

    tolerance: float
    measure: Measure
    error: float
    held: bool
    bones: int
    influences: int
    least_bones: int
    size: Size
    prunings: tuple[Pruning, ...]
    attempts: tuple[Attempt, ...]


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Smallest(Decomposition):
    """The smallest model that was found to hold a tolerance, or the closest one.

    A smaller model may have a larger error, so that in `history` `rmse` may rise up to the
    tolerance.

    Attributes
    ----------
    parsimony : Parsimony
        How small it is, and what was tried.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small").frames(slice(0, 4))
    >>> result = ssdr.smallest(dancer, tolerance="2%", effort="fast")
    >>> result.parsimony.bones == result.skinning.n_bones
    True
    """

    parsimony: Parsimony


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
    influence = influence_bytes(bones)
    parent = influence - 2 if skinning.parents is not None else 0
    times = np.where(keys < frames, keys * time_bytes(frames), 0)
    return Size(
        rest=12 * skinning.n_vertices,
        weights=skinning.n_vertices + influence * int(np.count_nonzero(skinning.weights)),
        joints=(12 + parent) * bones,
        keys=int((keys * key_bytes(skinning) + times).sum()),
    )


def influence_bytes(bones: int) -> int:
    """Bytes per influence of a vertex: a weight of 16 bits, and an index."""
    return 3 if bones <= 256 else 4


def key_bytes(skinning: Skinning) -> NDArray[np.int64]:
    """Bytes per key of each bone (B,)."""
    each = np.full(skinning.n_bones, _KEY_BYTES[skinning.bone_model])
    if skinning.parents is None:
        return each
    tree = skinning.parents, skinning.joint_positions
    moving = translating(skinning.transforms, *tree, rest_diagonal(skinning.rest))
    return np.where(moving, each, each - _TRANSLATION_BYTES)


def time_bytes(frames: int) -> int:
    """Bytes per frame number of a key."""
    return 2 if frames <= 1 << 16 else 4
