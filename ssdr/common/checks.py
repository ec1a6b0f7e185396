"""Checks of arguments; each error names the argument, what was expected and what was given."""

from __future__ import annotations

import difflib
import functools
import inspect
import math
import re
import sys
import warnings
from collections.abc import Callable
from typing import Any, Literal, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from .errors import InputError, SsdrWarning, check_choice, is_real, is_whole

P = ParamSpec("P")
R = TypeVar("R")
BoneModel = Literal["rigid", "similarity", "affine"]
Array = NDArray[np.float64]

LARGEST = 1e100  # bound on numbers whose squares are summed
_MOST_INFLUENCES = 64
# Least importance of a frame, relative to the largest: with less, the steps of all bones together
# would be blind to the transforms of that frame.
_LEAST_FRAME = 1e-4
_LEAST_DETERMINANT = 1e-12  # least determinant of an affine bone; a smaller one flattens the mesh
_OFF = 1e-4  # largest deviation of sums of weights from 1, and of rotations from orthogonal
_ROUNDING = 1e-13  # deviation from orthogonal that is rounding and left as it is
_SHARE = re.compile(r"\s*([0-9.]+(?:e[+-]?[0-9]+)?)\s*%\s*", re.IGNORECASE)

# --- numbers -----------------------------------------------------------------------------------


def check_whole(
    value: Any, argument: str, least: int, most: int | None = None, note: str = ""
) -> int:
    """Check that a value is an integer from `least` to `most`, and return it.

    `note` is added to the error message.
    """
    expected = f"an integer >= {least}" if most is None else f"an integer from {least} to {most}"
    if not is_whole(value) or value < least or (most is not None and value > most):
        raise InputError(argument, f"{expected}{note}", repr(value))
    return int(value)


def check_nonnegative(value: Any, argument: str, expected: str) -> float:
    """Check that a value is a finite number >= 0, and return it as a float."""
    if not (is_real(value) and value >= 0):
        raise InputError(argument, expected, repr(value))
    return float(value)


def check_smoothness(smoothness: Any, faces: NDArray[np.int32]) -> float:
    value = check_nonnegative(smoothness, "smoothness", "a length >= 0 in the mesh's units")
    if value > 0 and len(faces) == 0:
        wanted = "0 for a mesh without faces (MeshSequence(frames, faces) has them)"
        raise InputError("smoothness", wanted, smoothness)
    return value


def check_influences(influences: Any) -> int:
    return check_whole(influences, "influences", 1, _MOST_INFLUENCES)


def check_bone_model(bone_model: Any) -> BoneModel:
    check_choice(bone_model, "bone_model", BoneModel)
    model: BoneModel = bone_model
    return model


def check_rng(rng: Any) -> np.random.Generator:
    if isinstance(rng, np.random.Generator):
        return rng
    seed = check_whole(rng, "rng", 0, note=" or a numpy.random.Generator")
    return np.random.default_rng(seed)


def parse_tolerance(
    tolerance: Any, diagonal: float, argument: str = "tolerance", others: str = ""
) -> float:
    """Convert a tolerance, a length or a share such as ``"0.5%"``, to the mesh's units.

    A message names `argument`, and `others`, what else it may be.

    Raises
    ------
    InputError
        If it is neither a positive length nor a positive share of the diagonal.
    """
    number, unit = math.nan, 1.0
    if isinstance(tolerance, str):
        match = _SHARE.fullmatch(tolerance)
        unit = diagonal / 100
        try:
            number = float(match[1]) if match else math.nan
        except ValueError:  # such as 1.2.3
            number = math.nan
    elif is_real(tolerance):
        number = float(tolerance)
    if not (math.isfinite(number) and number > 0):
        expected = 'a length > 0 in the mesh\'s units, or a share of the diagonal such as "0.5%"'
        raise InputError(argument, others + expected, repr(tolerance))
    return number * unit


def parse_normals(normals: Any, diagonal: Callable[[], float] = lambda: 1.0) -> float | None:
    """Length below which errors of positions do not count against normals; None for False.

    It is 0 for True; anything else is parsed like a tolerance, with a `diagonal` that is computed
    only for a share.
    """
    if isinstance(normals, (bool, np.bool_)):
        return 0.0 if normals else None
    unit = diagonal() if isinstance(normals, str) else 1.0
    return parse_tolerance(normals, unit, "normals", "True, False, ")


def check_callback(callback: Any) -> Any:
    """Check that a callback is a function or None, and return it."""
    if callback is not None and not callable(callback):
        raise InputError("callback", "a function of one Progress, or None", repr(callback))
    return callback


def names_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator of a public function: an InputError for an unknown keyword, and result.warnings.

    The warnings name the line at which the user called the function.
    """
    known = list(inspect.signature(function).parameters)

    @functools.wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> R:
        for name in kwargs:
            if name not in known:
                near = difflib.get_close_matches(name, known, 1) or known
                unknown = f"an argument that {function.__name__} does not have"
                raise InputError(name, ", ".join(near), unknown)
        result = function(*args, **kwargs)
        for note in getattr(result, "warnings", ()):
            warnings.warn(note, SsdrWarning, stacklevel=2)
        return result

    return checked


# --- arrays ------------------------------------------------------------------------------------


def as_array(value: Any, argument: str, expected: str) -> NDArray[Any]:
    """Convert a value to an array.

    A tensor may lie on any device and have a gradient; a ``trimesh.Trimesh`` stands for its
    vertices.  Both may come in lists.

    Raises
    ------
    InputError
        If NumPy cannot make an array of the value, such as of rows of different lengths.
    """
    try:
        several = isinstance(value, (list, tuple))
        return np.asarray(list(map(_here, value)) if several else _here(value))
    except (TypeError, ValueError, RuntimeError) as error:
        raise InputError(argument, expected, str(error)) from error


def _here(value: Any) -> Any:
    """Vertices of a mesh, a tensor in this memory; any other value unchanged."""
    if are_meshes([value]):
        return value.vertices
    return value.detach().cpu().numpy() if hasattr(value, "detach") else value


def are_meshes(values: Any) -> bool:
    """Whether a list holds objects ``trimesh.Trimesh`` alone; trimesh is not imported for it."""
    kind = getattr(sys.modules.get("trimesh"), "Trimesh", ())
    listed = isinstance(values, (list, tuple)) and len(values) > 0
    return listed and all(isinstance(value, kind) for value in values)


def check_floats(
    value: Any,
    argument: str,
    shape: tuple[int | str, ...],
    *,
    copy: bool = False,
    empty: bool = False,
) -> NDArray[np.floating]:
    """Check that a value is real and finite; return it as a contiguous float32 or float64 array.

    Parameters
    ----------
    value : array_like
    argument : str
    shape : tuple of int and str
        Expected shape; a letter stands for any size but 0.
    copy : bool
        Return a float64 copy, so that later writes to `value` do not change the result.
    empty : bool
        Whether a size may be 0.
    """
    wanted = f"shape ({', '.join(str(s) for s in shape)})"
    array = as_array(value, argument, f"numbers of {wanted}")
    wanted += remedy_of_shape(array.shape, shape)
    if array.ndim != len(shape) or any(
        isinstance(s, int) and s != n for s, n in zip(shape, array.shape, strict=True)
    ):
        raise InputError(argument, wanted, f"shape {array.shape}")
    if array.size == 0 and not empty:
        raise InputError(argument, f"{wanted}, none of them 0", f"shape {array.shape}")
    if array.dtype.kind not in "fiu":
        raise InputError(argument, "real numbers", f"dtype {array.dtype}")
    if copy:
        array = np.array(array, dtype=np.float64, order="C")
    elif array.dtype not in (np.dtype(np.float32), np.dtype(np.float64)):
        array = array.astype(np.float64)
    finite = np.isfinite(array)
    if not finite.all():
        first = tuple(int(k) for k in np.unravel_index(finite.argmin(), finite.shape))
        raise InputError(argument, "finite numbers", f"NaN or Inf at {first}")
    return np.ascontiguousarray(array)


def remedy_of_shape(came: tuple[int, ...], wanted: tuple[int | str, ...]) -> str:
    """Hint for an error: how to convert an array of another common shape, or "" for any other."""
    if wanted[-2:] == (3, 4) and len(came) > 2:
        if came[-2:] == (4, 4):
            return " (of 4×4 matrices for column vectors pass m[..., :3, :])"
        if came[-2:] == (4, 3):
            return " (of matrices for row vectors pass np.swapaxes(m, -1, -2))"
    if wanted == ("T", 3) and len(came) == 2 and came[1] == 4:
        return " (of quads q pass np.concatenate([q[:, [0, 1, 2]], q[:, [0, 2, 3]]]))"
    if wanted == ("F", "V", 3) and len(came) == 2 and came[1] == 3:
        return " (of a single frame pass frame[None])"
    return ""


def check_squarable(array: NDArray[np.floating], argument: str, expected: str = "") -> None:
    """Raise an InputError for numbers so large that their squares cannot be summed."""
    if array.size and not np.abs(array).max() < LARGEST:
        raise InputError(argument, expected or f"numbers of less than {LARGEST:g}", "larger ones")


def check_frames(frames: Any, n_frames: int) -> Any:
    """Check an integer, slice, mask or indices of frames, and return an index into an array."""
    if isinstance(frames, slice):
        return frames
    given = np.asarray(frames)
    index = np.atleast_1d(given)
    if index.dtype == bool and index.shape == (n_frames,):
        return index
    usable = index.ndim == 1 and (index.dtype.kind in "iu" or index.size == 0)
    if not usable or (index.size and not -n_frames <= index.min() <= index.max() < n_frames):
        raise InputError("frames", f"indices below {n_frames}, a slice or a mask", frames)
    return index.astype(np.intp) if given.ndim else int(given)


def check_mask(
    value: Any, argument: str, count: int, *, default: bool = False
) -> NDArray[np.bool_]:
    """Convert a mask or indices to a mask ``(count,)``; for None, all entries are `default`."""
    if value is None:
        return np.full(count, default)
    array = as_array(value, argument, "a mask or a list of indices")
    if array.dtype == bool:
        if array.shape != (count,):
            raise InputError(argument, f"a mask of shape ({count},)", f"shape {array.shape}")
        return array.copy()
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise InputError(argument, "a mask or a list of indices", f"{array.dtype} {array.shape}")
    mask = np.zeros(count, dtype=bool)
    if array.size:
        check_range(array, argument, count)
        mask[array] = True
    return mask


def check_importance(value: Any, argument: str, count: int) -> Array | None:
    """Check that importance is >= 0 and not all 0; return it, or None if it is not given.

    It is returned as an array ``(count,)``, scaled to a maximum of 1.
    """
    if value is None:
        return None
    if isinstance(value, np.ndarray) and value.dtype == bool:  # a mask of what counts
        value = value.astype(np.float64)
    array = check_floats(value, argument, (count,), copy=True)
    if (array < 0).any() or not array.max() > 0:
        raise InputError(argument, "numbers >= 0, not all 0", f"minimum {array.min()}")
    return np.asarray(array / array.max())


def check_frame_importance(value: Any, count: int) -> Array | None:
    """Check that the importance of frames is > 0; return it, or None if it is not given.

    It is returned as an array ``(count,)``, scaled to a maximum of 1 and raised to at least 1e-4.
    """
    array = check_importance(value, "frame_importance", count)
    if array is None:
        return None
    if not (array > 0).all():
        raise InputError("frame_importance", "numbers > 0", float(array.min()))
    return np.maximum(array, _LEAST_FRAME)


# --- parts of a mesh and of a model ------------------------------------------------------------


def check_faces(faces: Any, n_vertices: int, argument: str = "faces") -> NDArray[np.int32]:
    """Check the range of triangles; return them as int32 ``(T, 3)``, an empty array for None."""
    wanted = "an array of shape (T, 3)"
    array = as_array(() if faces is None else faces, argument, wanted)
    if array.size == 0:
        return np.zeros((0, 3), dtype=np.int32)
    if array.ndim != 2 or array.shape[1] != 3:
        wanted += remedy_of_shape(array.shape, ("T", 3))
        raise InputError(argument, wanted, f"shape {array.shape}")
    if array.dtype.kind not in "iu":
        raise InputError(argument, "integers", f"dtype {array.dtype}")
    bad = (array < 0) | (array >= n_vertices)
    if bad.any():
        row, corner = (int(k) for k in np.argwhere(bad)[0])
        raise InputError(
            argument,
            f"indices from 0 to {n_vertices - 1}",
            f"{array[row, corner]} in face {row} ({int(bad.sum())} such indices)",
        )
    return np.ascontiguousarray(array, dtype=np.int32)


def check_skin(
    indices: Any, weights: Any, n_vertices: int, n_bones: int | None = None, prefix: str = ""
) -> tuple[NDArray[np.int32], NDArray[np.floating]]:
    """Check bone indices and weights, and return both as arrays ``(V, K)``.

    Weights must be >= 0 and sum to 1 at each vertex, within 1e-4.  `prefix` is put before the names
    of the arguments in errors, such as ``"start."``.
    """
    w = check_floats(weights, f"{prefix}weights", (n_vertices, "K"))
    wanted = f"integers of shape {w.shape}"
    j = as_array(indices, f"{prefix}indices", wanted)
    if j.shape != w.shape or j.dtype.kind not in "iu":
        if indices is None:
            wanted += " (of weights (V, B) of all bones: Skinning.from_dense)"
        raise InputError(f"{prefix}indices", wanted, f"{j.dtype} {j.shape}")
    check_range(j, f"{prefix}indices", np.iinfo(np.int32).max if n_bones is None else n_bones)
    if w.min() < 0:
        raise InputError(f"{prefix}weights", "numbers >= 0", f"{w.min()}")
    off = np.abs(w.sum(axis=1, dtype=np.float64) - 1)
    if off.max() > _OFF:
        worst = int(off.argmax())
        came = f"{w[worst].sum()} at vertex {worst}"
        raise InputError(f"{prefix}weights", "rows that sum to 1", came)
    return np.ascontiguousarray(j, dtype=np.int32), w


def check_dense(weights: Any, n_vertices: int | str = "V") -> NDArray[np.floating]:
    """Check weights of all bones, and return them as an array ``(V, B)``.

    They may be a sparse array.  Their sums are not checked.
    """
    array = weights.toarray() if hasattr(weights, "toarray") else weights
    return check_floats(array, "weights", (n_vertices, "B"))


def check_transforms(
    transforms: Any, n_frames: int, bone_model: BoneModel = "rigid", prefix: str = ""
) -> Array:
    """Check that transforms are of the bone model, and return them as ``(F, B, 3, 4)``.

    Rotations (of rigid bones and similarities) may deviate from orthogonal by 1e-4 and are made
    orthogonal.  Affine maps need a positive determinant.  `prefix` is put before the name of the
    argument in errors, such as ``"start."``.
    """
    argument = f"{prefix}transforms"
    m = check_floats(transforms, argument, (n_frames, "B", 3, 4), copy=True)
    check_squarable(m, argument)
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
        raise InputError(argument, expected, "a 3×3 block of zeros")
    det, off = np.linalg.det(r / size[..., None, None]), 0.0
    if bone_model != "affine":
        off = float(np.abs(gram / size[..., None, None] ** 2 - np.eye(3)).max())
        if off > _OFF:
            raise InputError(argument, expected, _off_by(gram, off, bone_model))
    if (det < 0).any():
        raise InputError(argument, expected, "a reflection")
    if bone_model == "affine":
        if not (det > _LEAST_DETERMINANT).all():
            raise InputError(argument, expected, "a singular 3×3 block")
        return np.asarray(m, dtype=np.float64)
    if off <= _ROUNDING:
        return np.asarray(m, dtype=np.float64)
    u, _, vt = np.linalg.svd(r)
    m[..., :3] = (u @ vt) * size[..., None, None]
    return np.asarray(m, dtype=np.float64)


def _off_by(gram: Array, off: float, bone_model: BoneModel) -> str:
    """Error text: how far 3×3 blocks R are from a bone model, and which bone model allows them.

    `gram` holds RᵀR, and `off` is its largest deviation from what the bone model requires.
    """
    square = np.trace(gram, axis1=-2, axis2=-1)[..., None, None] / 3
    even = np.abs(gram - square * np.eye(3)).max() <= _OFF * square.max()
    if bone_model == "rigid" and even:
        size = np.sqrt(square)
        sizes = f"scales from {size.min():.4g} to {size.max():.4g}"
        return f'blocks off by {off:.2g}, with {sizes} (bone_model="similarity" allows them)'
    return f'blocks off by {off:.2g}, which shear or stretch (bone_model="affine" allows them)'


def check_range(array: NDArray[Any], argument: str, count: int) -> None:
    if array.size and (array.min() < 0 or array.max() >= count):
        raise InputError(
            argument, f"indices from 0 to {count - 1}", f"{array.min()} to {array.max()}"
        )
