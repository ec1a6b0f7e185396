"""Arguments that several public functions share, checked once at the door."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import InputError, check_choice, is_real, is_whole
from .sequence import MeshSequence
from .skinning import BoneModel

__all__ = [
    "LARGEST",
    "as_sequences",
    "check_bone_model",
    "check_bones",
    "check_count",
    "check_importance",
    "check_index",
    "check_influences",
    "check_mask",
    "check_nonnegative",
    "check_rest",
    "check_rng",
    "check_squarable",
    "check_transforms",
    "check_weights",
    "parse_tolerance",
]

_LARGEST_INDEX = int(np.iinfo(np.int32).max)

Array = NDArray[np.float64]


_EXPECTED = 'a length > 0 in the mesh\'s units, or a share of the diagonal such as "0.5%"'
_SHARE = re.compile(r"\s*([0-9.]+(?:e[+-]?[0-9]+)?)\s*%\s*", re.IGNORECASE)
LARGEST = 1e100  # of what is summed in squares


def as_sequences(sequence: Any, faces: Any = None) -> list[MeshSequence]:
    """A sequence, several shots of one mesh, or plain (F, V, 3) frames and faces."""
    if isinstance(sequence, MeshSequence):
        shots = [sequence]
    elif (
        isinstance(sequence, Sequence)
        and len(sequence) > 0
        and any(isinstance(s, MeshSequence) for s in sequence)
    ):
        shots = list(sequence)
    elif (
        isinstance(sequence, Sequence)
        and len(sequence) > 0
        and all(getattr(s, "ndim", 0) == 3 for s in sequence)
    ):
        raise InputError(
            "sequence",
            "several shots as a list of MeshSequence",
            f"a list of {len(sequence)} arrays (F, V, 3)",
        )
    else:
        return [MeshSequence(sequence, faces)]
    if faces is not None:
        raise InputError("faces", "None beside a MeshSequence, which has its own", type(faces))
    for k, shot in enumerate(shots):
        if not isinstance(shot, MeshSequence):
            raise InputError(f"sequence[{k}]", "a MeshSequence", type(shot).__name__)
        if shot.n_vertices != shots[0].n_vertices:
            raise InputError(
                f"sequence[{k}]",
                f"{shots[0].n_vertices} vertices, as in the first shot",
                shot.n_vertices,
            )
        if not np.array_equal(shot.faces, shots[0].faces):
            raise InputError(f"sequence[{k}].faces", "the faces of the first shot", "others")
    return shots


def _integer(value: Any, argument: str, expected: str) -> int:
    if not is_whole(value):
        raise InputError(argument, expected, repr(value))
    return int(value)


def check_count(value: Any, argument: str, expected: str = "an integer >= 1") -> int:
    count = _integer(value, argument, expected)
    if count < 1:
        raise InputError(argument, expected, count)
    return count


def check_index(value: Any, argument: str, count: int) -> int:
    expected = f"an integer from 0 to {count - 1}"
    index = _integer(value, argument, expected)
    if not 0 <= index < count:
        raise InputError(argument, expected, index)
    return index


def check_nonnegative(value: Any, argument: str, expected: str) -> float:
    """A finite real number >= 0."""
    if not (is_real(value) and value >= 0):
        raise InputError(argument, expected, repr(value))
    return float(value)


def check_bones(bones: Any, n_vertices: int) -> int:
    expected = f"an integer from 1 to {n_vertices} (the number of vertices)"
    count = _integer(bones, "bones", expected)
    if not 1 <= count <= n_vertices:
        raise InputError("bones", expected, count)
    return count


def check_bone_model(bone_model: Any) -> BoneModel:
    check_choice(bone_model, "bone_model", BoneModel)
    model: BoneModel = bone_model
    return model


def check_influences(influences: Any) -> int:
    expected = "an integer from 1 to 64"
    count = _integer(influences, "influences", expected)
    if not 1 <= count <= 64:
        raise InputError("influences", expected, count)
    return count


def check_rng(rng: Any) -> np.random.Generator:
    if isinstance(rng, np.random.Generator):
        # one kind inside, whatever the caller's: its state is saved and restored as plain numbers
        return np.random.default_rng(int(rng.integers(2**63)))
    seed = _integer(rng, "rng", "a non-negative integer or a numpy.random.Generator")
    if seed < 0:
        raise InputError("rng", "a non-negative integer or a numpy.random.Generator", seed)
    return np.random.default_rng(seed)


def _finite(value: Any, argument: str, shape: tuple[Any, ...]) -> Array:
    try:
        array = np.asarray(value)
        real = array.dtype.kind != "c"
        array = array.astype(np.float64, copy=False) if real else array
    except (TypeError, ValueError) as error:
        raise InputError(argument, f"numbers of shape {shape}", str(error)) from error
    if not real:
        raise InputError(argument, "real numbers", f"dtype {array.dtype}")
    if array.ndim != len(shape) or any(
        isinstance(s, int) and s != n for s, n in zip(shape, array.shape, strict=True)
    ):
        raise InputError(argument, f"shape {shape}", f"shape {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(argument, "finite numbers", "NaN or Inf")
    return np.array(array, order="C")  # a copy: a callback may write to the caller's


def _squarable(value: Any, argument: str, shape: tuple[Any, ...]) -> Array:
    array = _finite(value, argument, shape)
    check_squarable(array, argument, f"numbers of less than {LARGEST:g}")
    return array


def check_rest(rest: Any, n_vertices: int) -> Array:
    return _squarable(rest, "rest", (n_vertices, 3))


def check_transforms(transforms: Any, n_frames: int, bone_model: BoneModel = "rigid") -> Array:
    """Transforms (F, B, 3, 4) that the bone model allows.

    Rotations, scaled or not, orthogonal to 1e-4 and then cleaned; affine maps
    that keep orientation.
    """
    m = _squarable(transforms, "transforms", (n_frames, "B", 3, 4))
    if m.shape[1] < 1:
        raise InputError("transforms", "at least one bone", f"shape {m.shape}")
    r = m[..., :3]
    expected = {
        "rigid": "rigid transforms (rotations, det +1)",
        "similarity": "similarities (uniformly scaled rotations, det > 0)",
        "affine": "affine transforms that keep orientation (det > 0)",
    }[bone_model]
    gram = np.einsum("tjca,tjcb->tjab", r, r)
    size = np.ones(m.shape[:2])
    if bone_model != "rigid":
        size = np.sqrt(np.trace(gram, axis1=2, axis2=3) / 3)
    if not (size > 0).all():
        raise InputError("transforms", expected, "a 3×3 block of zeros")
    if bone_model != "affine":
        off = np.abs(gram / size[..., None, None] ** 2 - np.eye(3)).max()
        if off > 1e-4:
            raise InputError("transforms", expected, f"off by {off:.2g}")
    det = np.linalg.det(r / size[..., None, None])
    if (det < 0).any():
        raise InputError("transforms", expected, "a reflection")
    if bone_model == "affine":
        if not (det > 1e-12).all():
            raise InputError("transforms", expected, "a singular 3×3 block")
        return m
    u, _, vt = np.linalg.svd(r)
    clean = m.copy()
    clean[..., :3] = (u @ vt) * size[..., None, None]
    return clean


def check_weights(indices: Any, weights: Any, n_vertices: int) -> tuple[NDArray[np.int32], Array]:
    """Joints and weights (V, K): non-negative rows that sum to 1 within 1e-4."""
    w = _finite(weights, "weights", (n_vertices, "K"))
    try:
        j = np.asarray(indices)
    except (TypeError, ValueError) as error:
        raise InputError("indices", f"integers of shape {w.shape}", str(error)) from error
    if j.shape != w.shape or j.dtype.kind not in "iu":
        raise InputError("indices", f"integers of shape {w.shape}", f"{j.dtype} {j.shape}")
    if j.size and j.min() < 0:
        raise InputError("indices", "indices >= 0", int(j.min()))
    if j.size and j.max() > _LARGEST_INDEX:
        raise InputError("indices", f"indices up to {_LARGEST_INDEX}", int(j.max()))
    if (w < 0).any():
        raise InputError("weights", "numbers >= 0", float(w.min()))
    total = w.sum(axis=1)
    if w.shape[1] < 1 or np.abs(total - 1).max() > 1e-4:
        worst = int(np.abs(total - 1).argmax()) if w.shape[1] else 0
        raise InputError("weights", "rows that sum to 1", f"{total[worst]} at vertex {worst}")
    return np.array(j, dtype=np.int32, order="C"), w / total[:, None]


def check_importance(value: Any, argument: str, count: int) -> Array | None:
    """Non-negative importance, not all zero, with a maximum of 1 (only ratios count)."""
    if value is None:
        return None
    array = _finite(value, argument, (count,))
    if (array < 0).any() or not array.max() > 0:
        raise InputError(argument, "numbers >= 0, not all 0", f"minimum {array.min()}")
    shares: Array = array / array.max()
    return shares


def check_mask(value: Any, argument: str, count: int) -> NDArray[np.bool_] | None:
    """A mask of `count` entries, given as such or as indices."""
    if value is None:
        return None
    try:
        array = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise InputError(argument, "a mask or a list of indices", str(error)) from error
    if array.dtype == bool:
        if array.shape != (count,):
            raise InputError(argument, f"a mask of shape ({count},)", f"shape {array.shape}")
        return array.copy()
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise InputError(argument, "a mask or a list of indices", f"{array.dtype} {array.shape}")
    mask = np.zeros(count, dtype=bool)
    if array.size:
        if array.min() < 0 or array.max() >= count:
            raise InputError(
                argument, f"indices from 0 to {count - 1}", f"{array.min()} to {array.max()}"
            )
        mask[array] = True
    return mask


def parse_tolerance(tolerance: Any, diagonal: float) -> float:
    """A tolerance in the mesh's units.

    Raises
    ------
    InputError
        If it is neither a positive length nor a positive share of the diagonal.
    """
    if isinstance(tolerance, str):
        match = _SHARE.fullmatch(tolerance)
        try:
            share = float(match[1]) / 100 if match else math.nan
        except ValueError:
            share = math.nan
        if not (math.isfinite(share) and share > 0):
            raise InputError("tolerance", _EXPECTED, repr(tolerance))
        return share * diagonal
    if not (is_real(tolerance) and float(tolerance) > 0):
        raise InputError("tolerance", _EXPECTED, repr(tolerance))
    return float(tolerance)


def check_squarable(array: NDArray[np.floating], argument: str, expected: str) -> None:
    """Whether its numbers can be squared and summed."""
    if array.size and not np.abs(array).max() < LARGEST:
        raise InputError(argument, expected, "larger ones")
