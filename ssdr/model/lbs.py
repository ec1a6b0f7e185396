"""Linear blend skinning (LBS), and its derivatives in reverse mode."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..common.checks import as_array, check_range, remedy_of_shape
from ..common.errors import InputError
from ..common.parallel import chunk_bounds, run_chunks
from ..common.short_repr import short_repr
from ..kernels.lbs import pull_back_to_bones, pull_back_to_vertices, skin_range

# vertices in a task; smaller tasks cost more calls, larger ones balance threads worse
_VERTEX_CHUNK = 1024


def skinning_in(thing: Any) -> Any:
    """The model of a result that has one; any other object, such as a model itself, unchanged."""
    return thing if hasattr(thing, "skin") else getattr(thing, "skinning", thing)


def skin(
    rest: Any,
    indices: Any = None,
    weights: Any = None,
    transforms: Any = None,
    *,
    dtype: Any = None,
) -> NDArray[np.floating]:
    """Linear blend skinning: v_i^t = Σ_k w_ik M_{j_ik}^t (p_i, 1).

    Parameters
    ----------
    rest : (V, 3) array, or a model or result in place of all four arrays
    indices : (V, K) int array
    weights : (V, K) array
    transforms : (F, B, 3, 4) or (B, 3, 4) array
    dtype : float32 or float64, optional
        Precision of the computation and of the result; the widest of the
        inputs by default.

    Returns
    -------
    (F, V, 3) array, or (V, 3) for a single frame.

    Raises
    ------
    InputError
        If shapes do not match or an index is out of range.

    References
    ----------
    Magnenat-Thalmann et al., "Joint-dependent local deformations", 1988.

    Examples
    --------
    >>> move = np.eye(3, 4)[None]
    >>> move[0, :, 3] = [1, 2, 3]
    >>> posed = ssdr.skin(np.zeros((2, 3)), np.zeros((2, 1), int), np.ones((2, 1)), move)
    >>> np.allclose(posed, [1, 2, 3])
    True
    """
    model = skinning_in(rest)
    if hasattr(model, "skin"):
        _refuse_beside_model(indices=indices, weights=weights, transforms=transforms)
        posed: NDArray[np.floating] = model.skin(dtype=dtype)
        return posed
    parts = _checked(rest, indices, weights, transforms, dtype=dtype)
    out = np.empty((len(parts.transforms), len(parts.rest), 3), dtype=parts.rest.dtype)

    def work(_: int, first: int, last: int) -> None:
        skin_range(*parts, out, first, last)

    run_chunks(work, chunk_bounds(len(parts.rest), _VERTEX_CHUNK))
    return out if np.ndim(transforms) == 4 else out[0]


def skin_each(
    rests: NDArray[np.floating],
    indices: ArrayLike,
    weights: ArrayLike,
    transforms: NDArray[np.floating],
    *,
    dtype: Any = None,
) -> NDArray[np.floating]:
    """Positions ``(F, V, 3)`` skinned as by :func:`skin`, with one rest pose for each frame.

    Parameters
    ----------
    rests : (F, V, 3) array
    indices, weights, dtype
        As in :func:`skin`.
    transforms : (F, B, 3, 4) array
    """
    both = zip(rests, transforms, strict=True)
    posed = [skin(p, indices, weights, moves, dtype=dtype) for p, moves in both]
    return np.stack(posed) if posed else np.empty(rests.shape, dtype=dtype or rests.dtype)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SkinGradients:
    """Gradients of a scalar with respect to rest pose, weights and transforms of :func:`skin`.

    Attributes
    ----------
    rest : (V, 3) array
    weights : (V, K) array
        Derivative for each weight, also where it is 0, as if weights need not sum to 1.
    transforms : (F, B, 3, 4) array, or (B, 3, 4) for a single frame
        Derivative for each entry, as if rotations need not be orthogonal.

    Examples
    --------
    >>> moves = np.eye(3, 4)[None]
    >>> parts = np.ones((2, 3)), np.zeros((2, 1), int), np.ones((2, 1)), moves
    >>> ssdr.skin_gradients(*parts, np.ones((2, 3))).weights
    array([[3.],
           [3.]])
    """

    rest: NDArray[np.floating]
    weights: NDArray[np.floating]
    transforms: NDArray[np.floating]

    __repr__ = short_repr


def skin_gradients(
    rest: Any,
    indices: Any = None,
    weights: Any = None,
    transforms: Any = None,
    gradient: Any = None,
    *,
    dtype: Any = None,
) -> SkinGradients:
    """Gradients of a scalar with respect to the inputs of :func:`skin`, from that of the output.

    This is the reverse mode (the product of a vector and the Jacobian).  With g_i^t the gradient
    with respect to position v_i^t and p̃ = (p, 1), the gradients are Σ_t Σ_k w_ik R_{j_ik}^tᵀ g_i^t
    for the rest positions, Σ_t g_i^t · M_{j_ik}^t p̃_i for the weights, and Σ w_ik g_i^t p̃_iᵀ,
    over the influences of a bone, for its transforms.

    Parameters
    ----------
    rest, indices, weights, transforms
        As in :func:`skin`; a model in their place must have no shapes.
    gradient : (F, V, 3) or (V, 3) array
        Gradient with respect to the result of :func:`skin`, of the same shape.
    dtype : float32 or float64, optional
        Precision of the result; the widest of the inputs by default.  Sums are float64.

    Returns
    -------
    SkinGradients

    Raises
    ------
    InputError
        If shapes do not match or an index is out of range.

    References
    ----------
    Griewank and Walther, "Evaluating derivatives", 2008, section 3.2, for the reverse mode.

    Examples
    --------
    Gradients of half the squared distance to a target:

    >>> rng = np.random.default_rng(0)
    >>> rest, target = rng.random((2, 4, 3))
    >>> parts = rest, np.zeros((4, 1), int), np.ones((4, 1)), np.eye(3, 4)[None]
    >>> gradients = ssdr.skin_gradients(*parts, ssdr.skin(*parts) - target)
    >>> np.allclose(gradients.rest, rest - target)
    True
    """
    model = skinning_in(rest)
    if hasattr(model, "skin"):
        _refuse_beside_model(indices=indices, weights=weights, transforms=transforms)
        if not hasattr(model, "rest"):
            raise InputError("rest", "a model without shapes", type(model).__name__)
        rest, indices, weights, transforms = (
            getattr(model, name) for name in ("rest", "indices", "weights", "transforms")
        )
    gradient = as_array(gradient, "gradient", "shape (F, V, 3)")
    parts = _checked(rest, indices, weights, transforms, gradient=gradient, dtype=dtype)
    frames, (n, k) = len(parts.transforms), parts.weights.shape
    shape = (frames, n, 3) if np.ndim(transforms) == 4 else (n, 3)
    if np.shape(gradient) != shape:
        wanted = f"shape {shape}, as skin returns it"
        raise InputError("gradient", wanted, f"shape {np.shape(gradient)}")
    kind = parts.rest.dtype
    pulled = np.ascontiguousarray(gradient, dtype=kind).reshape(frames, n, 3)
    to_rest, to_weights = np.zeros((n, 3)), np.zeros((n, k))
    to_transforms = np.zeros(parts.transforms.shape)

    def vertices(_: int, first: int, last: int) -> None:
        pull_back_to_vertices(*parts, pulled, to_rest, to_weights, first, last)

    def bones(_: int, first: int, last: int) -> None:
        pull_back_to_bones(*parts[:3], pulled, to_transforms, first, last)

    run_chunks(vertices, chunk_bounds(n, _VERTEX_CHUNK))
    run_chunks(bones, chunk_bounds(frames, 1))
    return SkinGradients(
        rest=to_rest.astype(kind, copy=False),
        weights=to_weights.astype(kind, copy=False),
        transforms=to_transforms.reshape(np.shape(transforms)).astype(kind, copy=False),
    )


def _refuse_beside_model(**arrays: Any) -> None:
    for name, value in arrays.items():
        if value is not None:
            raise InputError(name, "None beside a model, which has its own", "an array")


class _Parts(NamedTuple):
    """Arguments of the kernels, in one precision."""

    rest: NDArray[np.floating]
    indices: NDArray[np.int32]
    weights: NDArray[np.floating]
    transforms: NDArray[np.floating]  # with an axis of frames


def _checked(
    rest: Any, indices: Any, weights: Any, transforms: Any, *, dtype: Any, **further: Any
) -> _Parts:
    """Check the arguments and return them in `dtype`, by default the widest type of all arrays.

    The types of the arrays in `further` are considered as well, but the arrays are not returned.
    """
    p, j = as_array(rest, "rest", "shape (V, 3)"), as_array(indices, "indices", "shape (V, K)")
    w = as_array(weights, "weights", "shape (V, K)")
    m = as_array(transforms, "transforms", "shape (F, B, 3, 4) or (B, 3, 4)")
    if p.ndim != 2 or p.shape[1] != 3:
        raise InputError("rest", "shape (V, 3)", f"shape {p.shape}")
    if j.ndim != 2 or len(j) != len(p) or j.shape[1] < 1 or j.dtype.kind not in "iu":
        raise InputError("indices", f"integers of shape ({len(p)}, K)", f"{j.dtype} {j.shape}")
    if w.shape != j.shape:
        raise InputError("weights", f"shape {j.shape}", f"shape {w.shape}")
    if m.ndim not in (3, 4) or m.shape[-2:] != (3, 4):
        wanted = f"shape (F, B, 3, 4) or (B, 3, 4){remedy_of_shape(m.shape, (3, 4))}"
        raise InputError("transforms", wanted, f"shape {m.shape}")
    check_range(j, "indices", m.shape[-3])
    others = {name: as_array(x, name, "shape (F, V, 3)") for name, x in further.items()}
    for name, array in {"rest": p, "weights": w, "transforms": m, **others}.items():
        if array.dtype.kind not in "fiu":
            raise InputError(name, "real numbers", f"dtype {array.dtype}")
    try:
        kind = np.result_type(p, w, m, *others.values()) if dtype is None else np.dtype(dtype)
    except (TypeError, ValueError) as error:
        raise InputError("dtype", "float32, float64 or None", repr(dtype)) from error
    if kind not in (np.dtype(np.float32), np.dtype(np.float64)):
        kind = np.dtype(np.float64)
    p, w, m = (np.ascontiguousarray(a, dtype=kind) for a in (p, w, m))
    frames = m if m.ndim == 4 else m[None]
    return _Parts(p, np.ascontiguousarray(j, dtype=np.int32), w, frames)
