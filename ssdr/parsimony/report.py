"""Report of a search for the smallest model: attempts, prunings, and the size in bytes."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import check_choice
from ..hierarchy.transforms import rest_diagonal, translating
from ..quantisation import WeightStorage
from ..result import Decomposition
from ..shapes import Shapes
from ..skinning import Skinning, check_skinning

__all__ = [
    "Attempt",
    "FileSize",
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

# Float32 numbers: rotation and translation; rotation, translation and scale; a 3×4 matrix.
_KEY_BYTES = {"rigid": 28, "similarity": 32, "affine": 48}
_TRANSLATION_BYTES = 12


@dataclasses.dataclass(frozen=True)
class Attempt:
    """Record of one attempt to reach the tolerance with a given number of bones.

    Attributes
    ----------
    bones : int
    error : float
        Error of the attempt's best model in the mesh's units, by the measure of the tolerance.  If
        normals have a tolerance, too, it is at least as large a part of the tolerance of positions
        as their mean angle is of theirs.
    iterations : int
        Number of alternations and polish steps.
    start : str
        What the attempt started from, such as "merged" or "new start".

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
        Bytes of the rest pose: 12 per vertex (three float32).
    weights : int
        Bytes of the weights: 1 per vertex for the number of its influences, and per influence 2 for
        a weight of 16 bits (1 of 8 bits) and 1 for the bone's index (2 if there are more than 256
        bones).
    joints : int
        Bytes of the joints: 12 per bone for its position in the rest pose, and in a hierarchy 1 for
        its parent (2 if there are more than 256 bones).
    keys : int
        Bytes of the keys: 28 per key of a rigid bone (rotation 16, translation 12, in float32), 32
        of a similarity bone, and 48 of an affine bone.  A key has 12 bytes less if the bone does
        not translate relative to its parent or, for a root, does not translate at all.  It has 2
        more (4 if there are more than 65,536 frames) for its frame number, unless the bone has a
        key at every frame.
    shapes : int
        Bytes of shapes: 12 per displaced vertex (three float32), and 2 for its number (4 if there
        are more than 65,536 vertices) in a shape that does not displace all; 4 per amount, and 2
        (4) for its frame where others of the shape are 0.

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


@dataclasses.dataclass(frozen=True)
class Pruning:
    """Number, bytes and error before and after one kind of pruning.

    Attributes
    ----------
    what : {"bones", "influences", "keyframes"}
    before, after : int
        Number of bones, of influences of all vertices, or of keys of all bones.
    bytes_before, bytes_after : int
        Bytes of the model.
    error_before, error_after : float
        Error of the model, as in :class:`Attempt`.

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
        """Rise of the error, in the mesh's units; negative if the new solve lowered it."""
        return self.error_after - self.error_before


@dataclasses.dataclass(frozen=True)
class FileSize:
    """Bytes of the compact file of a model, and the errors of what the file holds.

    Attributes
    ----------
    bytes : int
        Bytes of the whole file, with its triangles and textures.
    error : float
        Error of the vertices in the file, measured on all frames of the input, in the mesh's units,
        by the measure of the tolerance.  It is inf, and there are no bytes, if the weights of the
        file are too coarse for its own tolerance.
    normals : float or None
        Mean angle, in degrees, of the normals that engines draw of the file; None without any.

    Examples
    --------
    >>> ssdr.parsimony.FileSize(bytes=4000, error=0.25).bytes
    4000
    """

    bytes: int
    error: float
    normals: float | None = None


@dataclasses.dataclass(frozen=True)
class Parsimony:
    """Size and error of the smallest model, and how it was found.

    Attributes
    ----------
    tolerance : float
        Tolerance asked for, in the mesh's units.
    measure : {"rmse", "max"}
    normals_tolerance : float or None
        Tolerance of the mean angle of drawn normals, in degrees; that angle is `normals.mean` of
        the result.
    error : float
        Error of the result, measured on all frames.
    held : bool
        Whether all tolerances are held, in the `file`, too, if there is one.
    bones, influences : int
        Number of bones of the result, and largest number of influences at a vertex.
    least_bones : int
        Lower bound on the number of bones that can hold the tolerance, proven by the rank of the
        motion.
    size : Size
    prunings : tuple of Pruning
        Prunings of bones, influences and keyframes, in this order; if the search was stopped, the
        last ones are missing.
    attempts : tuple of Attempt
        All attempts, in order.
    file : FileSize or None
        Size of the compact file for which the model was chosen; None if none was described.

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
    normals_tolerance: float | None
    error: float
    held: bool
    bones: int
    influences: int
    least_bones: int
    size: Size
    prunings: tuple[Pruning, ...]
    attempts: tuple[Attempt, ...]
    file: FileSize | None = None


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Smallest(Decomposition):
    """Smallest model found that holds a tolerance; if none does, the model of least error.

    The `rmse` in `history` may rise up to the tolerance, since a smaller model may have a larger
    error.

    Attributes
    ----------
    parsimony : Parsimony
        Size of the model, and how it was found.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small").frames(slice(0, 4))
    >>> result = ssdr.smallest(dancer, tolerance="2%", effort="fast")
    >>> result.parsimony.bones == result.skinning.n_bones
    True
    """

    parsimony: Parsimony


def size(skinning: Skinning, *, storage: WeightStorage = "uint16") -> Size:
    """Bytes of a model: rest pose, nonzero weights, joints, and keys.

    Parameters
    ----------
    skinning : Skinning
        If its `keyframes` are None, every frame is a key of every bone.
    storage : {"uint16", "uint8", "float32"}
        Type in which a weight is stored; "float32" counts as "uint16", which is precise enough.

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
    skinning = check_skinning(skinning)
    frames, bones = skinning.transforms.shape[:2]
    keys = np.full(bones, frames)
    if skinning.keyframes is not None:
        keys = np.asarray(skinning.keyframes).sum(axis=0)
    check_choice(storage, "storage", WeightStorage)
    influence = influence_bytes(bones, storage)
    parent = index_bytes(bones) if skinning.parents is not None else 0
    times = np.where(keys < frames, keys * time_bytes(frames), 0)
    return Size(
        rest=12 * skinning.n_vertices,
        weights=skinning.n_vertices + influence * int(np.count_nonzero(skinning.weights)),
        joints=(12 + parent) * bones,
        keys=int((keys * key_bytes(skinning) + times).sum()),
        shapes=0 if skinning.shapes is None else _shape_bytes(skinning.shapes),
    )


def _shape_bytes(shapes: Shapes) -> int:
    """Bytes of displacements and amounts, each dense or sparse, whichever is fewer."""
    total = 0
    for values, each in ((shapes.moved.T, 12), (shapes.amounts != 0, 4)):
        used = values.sum(axis=0)
        sparse = used * (each + time_bytes(len(values)))
        total += int(np.minimum(sparse, each * len(values)).sum())
    return total


def influence_bytes(bones: int, storage: WeightStorage) -> int:
    """Bytes per influence: a weight of 16 bits, or of 8, and an index."""
    return (1 if storage == "uint8" else 2) + index_bytes(bones)


def index_bytes(bones: int) -> int:
    """Bytes of the index of a bone."""
    return 1 if bones <= 256 else 2


def key_bytes(skinning: Skinning) -> NDArray[np.int64]:
    """Bytes (B,) of one key of each bone."""
    each = np.full(skinning.n_bones, _KEY_BYTES[skinning.bone_model])
    if skinning.parents is None:
        return each
    tree = skinning.parents, skinning.joint_positions
    moving = translating(skinning.transforms, *tree, rest_diagonal(skinning.rest))
    return np.where(moving, each, each - _TRANSLATION_BYTES)


def time_bytes(frames: int) -> int:
    """Bytes of a key's frame number in an animation of `frames` frames."""
    return 2 if frames <= 1 << 16 else 4
