"""Rigid motions: Kabsch, quaternions (xyzw) and the 6D representation, batched.

All functions work over any leading axes and in float64.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..common.checks import as_array
from ..common.errors import InputError

__all__ = [
    "kabsch",
    "matrix_from_quaternion",
    "matrix_from_sixd",
    "nearest_rotation",
    "quaternion_from_matrix",
    "sixd_from_matrix",
    "slerp",
    "turn_between",
    "unflip_quaternions",
]

# largest ratio of the second to the first singular value at which points count as collinear
_COLLINEAR = 1e-13
# largest entry of a rotation or quaternion; products of larger numbers overflow
_LARGEST_ENTRY = 1e100
# Sine of an angle below which sin(u·angle)/sin(angle) is u to rounding: equal quaternions would
# divide zero by zero.
_SMALL_SINE = 1e-8


def kabsch(
    source: ArrayLike, target: ArrayLike, weights: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Rigid transform that carries one point set onto another with least squared error.

    Minimises Σ_i w_i ‖R s_i + T − t_i‖² over rotations R (det R = +1 always,
    also where a reflection would fit better) and translations T.

    Parameters
    ----------
    source, target : (..., N, 3) array
        Corresponding points; leading axes broadcast.
    weights : (..., N) array, optional
        Non-negative importance of each pair; 1 by default.  Where all are zero
        the identity rotation is returned.

    Returns
    -------
    (..., 3, 4) float64
        ``[R | T]``.  Where the points do not determine the rotation, the
        smallest that fits: the identity for coincident points, the rotation from
        line to line for collinear ones.

    Raises
    ------
    InputError
        If shapes do not match, a number is complex or not finite, a weight is negative
        or the translation is beyond float64.

    References
    ----------
    Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976;
    Umeyama, "Least-squares estimation of transformation parameters", 1991.

    Examples
    --------
    >>> source = np.eye(3)
    >>> transform = ssdr.kabsch(source, source + [1, 2, 3])
    >>> np.allclose(transform[:, :3], np.eye(3)), np.allclose(transform[:, 3], [1, 2, 3])
    (True, True)
    """
    s = _numbers(source, "source", 3)
    if s.ndim < 2 or s.shape[-2] < 1:
        raise InputError("source", "an array of shape (..., N, 3)", f"shape {s.shape}")
    t = _numbers(target, "target", *s.shape[-2:])
    w = np.ones(s.shape[-2]) if weights is None else _numbers(weights, "weights", s.shape[-2])
    if (w < 0).any():
        raise InputError("weights", "numbers >= 0", f"{w.min()}")
    _check_broadcast("target", s.shape[:-2], t.shape[:-2], w.shape[:-1])
    # Scaling by powers of two rounds nothing; products then neither overflow nor vanish.
    s, s_power = _scaled(s, (-2, -1))
    t, t_power = _scaled(t, (-2, -1))
    w, _ = _scaled(w, (-1,))
    total = w.sum(axis=-1)[..., None]
    share = np.where(total > 0, w / np.where(total > 0, total, 1.0), 1.0 / s.shape[-2])
    s_mean = np.einsum("...n,...nc->...c", share, s)
    t_mean = np.einsum("...n,...nc->...c", share, t)
    s_arm, _ = _scaled(s - s_mean[..., None, :], (-2, -1))
    t_arm, _ = _scaled(t - t_mean[..., None, :], (-2, -1))
    moment = np.einsum("...n,...na,...nb->...ab", share, t_arm, s_arm)
    moment = np.where(total[..., None] > 0, moment, np.eye(3))
    rotation = nearest_rotation(moment)
    with np.errstate(over="ignore", invalid="ignore"):
        s_mean, t_mean = np.ldexp(s_mean, s_power[..., 0]), np.ldexp(t_mean, t_power[..., 0])
        translation = t_mean - np.einsum("...ab,...b->...a", rotation, s_mean)
    if not np.isfinite(translation).all():
        raise InputError("target", "a translation within float64", "points further apart")
    return np.concatenate([rotation, translation[..., None]], axis=-1)


def _numbers(value: ArrayLike, argument: str, *last: int) -> NDArray[np.float64]:
    """Check that a value is finite, real and of shape ``(..., *last)``; return it as float64."""
    array = as_array(value, argument, "an array of numbers")
    if array.dtype.kind not in "fiub":
        raise InputError(argument, "real numbers", f"dtype {array.dtype}")
    if last and array.shape[-len(last) :] != last:
        expected = f"an array of shape (..., {', '.join(map(str, last))})"
        raise InputError(argument, expected, f"shape {array.shape}")
    array = array.astype(np.float64, copy=False)
    if not np.isfinite(array).all():
        raise InputError(argument, "finite numbers", "NaN or Inf")
    return array


def _check_broadcast(argument: str, *shapes: tuple[int, ...]) -> None:
    try:
        np.broadcast_shapes(*shapes)
    except ValueError as error:
        got = ", ".join(map(str, shapes))
        raise InputError(argument, "leading axes that broadcast", got) from error


def _scaled(
    array: NDArray[np.float64], axes: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.intc]]:
    """Array / 2^n and n, where n makes the largest magnitude along `axes` lie from 1/2 to 1.

    If all entries are 0, n is 0.
    """
    _, power = np.frexp(np.abs(array).max(axis=axes, keepdims=True, initial=0.0))
    return np.ldexp(array, -power), power


def nearest_rotation(moment: ArrayLike) -> NDArray[np.float64]:
    """Rotation R (det R = +1) nearest to M in the Frobenius norm; it maximises tr(Rᵀ M).

    In :func:`kabsch` M is Σ_i w_i t_i s_iᵀ, of points relative to their centroids.

    Parameters
    ----------
    moment : (..., 3, 3) array
        M; finite.

    Returns
    -------
    (..., 3, 3) float64
        U diag(1, 1, ±1) Vᵀ of M = U S Vᵀ.  Where M does not determine the rotation, the
        smallest that fits: the identity for M = 0, the rotation from line to line for rank 1.

    Raises
    ------
    InputError
        If the shape is wrong, or a number is complex or not finite.

    References
    ----------
    Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976;
    Umeyama, "Least-squares estimation of transformation parameters", 1991.

    Examples
    --------
    >>> np.allclose(ssdr.rigid.nearest_rotation(np.diag([3.0, 2.0, 1.0])), np.eye(3))
    True
    """
    m = _numbers(moment, "moment", 3, 3)
    u, s, vt = np.linalg.svd(m)
    u = u.copy()
    u[..., :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[..., None]
    rotation = np.asarray(u @ vt)
    line = s[..., 1] <= _COLLINEAR * s[..., 0]
    if line.any():
        turn = turn_between(vt[line][..., 0, :], u[line][..., :, 0])
        point = s[line][..., 0] == 0
        rotation[line] = np.where(point[..., None, None], np.eye(3), turn)
    return rotation


def turn_between(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smallest rotations ``(..., 3, 3)`` that carry unit vectors `a` to `b`, both ``(..., 3)``.

    Each is a product of two half turns.

    Examples
    --------
    >>> quarter = ssdr.rigid.turn_between(np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))
    >>> np.allclose(quarter, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    True
    """
    half = a + b
    size = np.linalg.norm(half, axis=-1, keepdims=True)
    # Between opposite vectors any half turn about an axis across them will do.
    across = np.cross(a, np.eye(3)[np.abs(a).argmin(axis=-1)])
    opposite = size < 1e-8
    first = np.where(opposite, across, half)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    flip_first = 2 * first[..., :, None] * first[..., None, :] - np.eye(3)
    flip_a = 2 * a[..., :, None] * a[..., None, :] - np.eye(3)
    return np.asarray(np.where(opposite[..., None], flip_first, flip_first @ flip_a))


def quaternion_from_matrix(rotation: ArrayLike) -> NDArray[np.float64]:
    """Unit quaternions ``(..., 4)`` xyzw of rotation matrices ``(..., 3, 3)``.

    The branch with the largest component is taken (Shepperd 1978), so that no
    rotation loses accuracy; w >= 0 on return.

    Raises
    ------
    InputError
        If the shape is wrong, or an entry is complex, not finite or far above 1.

    Examples
    --------
    >>> half_turn = np.diag([-1.0, -1.0, 1.0])
    >>> np.allclose(np.abs(ssdr.rigid.quaternion_from_matrix(half_turn)), [0, 0, 1, 0])
    True
    """
    r = _numbers(rotation, "rotation", 3, 3)
    if (np.abs(r) > _LARGEST_ENTRY).any():
        raise InputError("rotation", "rotation matrices", f"an entry of {np.abs(r).max():g}")
    diagonal = np.diagonal(r, axis1=-2, axis2=-1)
    trace = diagonal.sum(axis=-1)
    # 4 q qᵀ: every row is a multiple of the quaternion.
    table = np.empty((*r.shape[:-2], 4, 4))
    table[..., :3, :3] = r + np.swapaxes(r, -1, -2)
    table[..., range(3), range(3)] = 1 + 2 * diagonal - trace[..., None]
    for k, i, j in ((0, 2, 1), (1, 0, 2), (2, 1, 0)):
        table[..., 3, k] = table[..., k, 3] = r[..., i, j] - r[..., j, i]
    table[..., 3, 3] = 1 + trace
    choice = np.argmax(np.concatenate([diagonal, trace[..., None]], axis=-1), axis=-1)
    q = np.take_along_axis(table, choice[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., 3:] < 0, -q, q))


def matrix_from_quaternion(quaternion: ArrayLike) -> NDArray[np.float64]:
    """Rotation matrices ``(..., 3, 3)`` of quaternions ``(..., 4)`` xyzw of any norm but 0.

    Raises
    ------
    InputError
        If the shape is wrong, or a quaternion is zero, complex or not finite.

    Examples
    --------
    >>> half_turn = ssdr.rigid.matrix_from_quaternion([0, 0, 1, 0])
    >>> np.allclose(half_turn, np.diag([-1, -1, 1]))
    True
    """
    q, _ = _scaled(_numbers(quaternion, "quaternion", 4), (-1,))
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not (norm > 0).all():
        raise InputError("quaternion", "quaternions that are not zero", "zero")
    x, y, z, w = np.moveaxis(q / norm, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def unflip_quaternions(quaternion: ArrayLike) -> NDArray[np.float64]:
    """Quaternions with signs such that neighbours in time (axis 0) have a dot product >= 0.

    q and −q are the same rotation, but an engine that interpolates between keys
    of opposite sign takes the long way round.

    Raises
    ------
    InputError
        If there is no axis of time, or a number is complex or not finite.

    Examples
    --------
    >>> keys = np.array([[0, 0, 0, 1.0], [0, 0, 0, -1.0]])
    >>> np.allclose(ssdr.rigid.unflip_quaternions(keys), [0, 0, 0, 1])
    True
    """
    q = _numbers(quaternion, "quaternion", 4)
    if q.ndim < 2:
        raise InputError("quaternion", "shape (F, ..., 4)", f"shape {q.shape}")
    flip = np.ones(q.shape[:-1])
    small, _ = _scaled(q, (-1,))
    flip[1:] = np.where((small[1:] * small[:-1]).sum(axis=-1) < 0, -1.0, 1.0)
    return np.asarray(q * np.cumprod(flip, axis=0)[..., None])


def slerp(a: ArrayLike, b: ArrayLike, u: ArrayLike) -> NDArray[np.float64]:
    """Spherical linear interpolation of unit quaternions along the shorter arc.

    Parameters
    ----------
    a, b : (..., 4) array
        Unit quaternions; they are not normalised again.
    u : (...) array
        0 gives `a`, 1 gives `b` or −`b`, whichever is nearer to `a`.

    Returns
    -------
    (..., 4) float64

    Raises
    ------
    InputError
        If shapes do not fit, or a number is complex, not finite or far above 1.

    References
    ----------
    Shoemake, "Animating rotation with quaternion curves", 1985.

    Examples
    --------
    >>> none = np.array([0.0, 0.0, 0.0, 1.0])
    >>> quarter = ssdr.rigid.quaternion_from_matrix([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    >>> eighth = ssdr.rigid.slerp(none, quarter, np.array(0.5))
    >>> np.allclose(2 * np.degrees(np.arccos(eighth[3])), 45)
    True
    """
    a, b, u = _numbers(a, "a", 4), _numbers(b, "b", 4), _numbers(u, "u")
    if max(np.abs(x).max(initial=0.0) for x in (a, b, u)) > _LARGEST_ENTRY:
        raise InputError("a, b and u", f"numbers up to {_LARGEST_ENTRY:g}", "larger ones")
    _check_broadcast("u", a.shape[:-1], b.shape[:-1], u.shape)
    u = u[..., None]
    b = np.where((a * b).sum(axis=-1, keepdims=True) < 0, -b, b)
    # Half the angle by arctan2: arccos loses half the digits near 1.
    angle = 2 * np.arctan2(
        np.linalg.norm(a - b, axis=-1, keepdims=True), np.linalg.norm(a + b, axis=-1, keepdims=True)
    )
    sine = np.sin(angle)
    near = sine < _SMALL_SINE
    safe = np.where(near, 1.0, sine)
    from_a = np.where(near, 1 - u, np.sin((1 - u) * angle) / safe)
    from_b = np.where(near, u, np.sin(u * angle) / safe)
    return np.asarray(from_a * a + from_b * b)


def sixd_from_matrix(rotation: ArrayLike) -> NDArray[np.float64]:
    """First two columns of rotation matrices, ``(..., 6)`` (Zhou et al. 2019).

    Examples
    --------
    >>> np.allclose(ssdr.rigid.sixd_from_matrix(np.eye(3)), [1, 0, 0, 0, 1, 0])
    True
    """
    r = _numbers(rotation, "rotation", 3, 3)
    return np.concatenate([r[..., :, 0], r[..., :, 1]], axis=-1)


def matrix_from_sixd(sixd: ArrayLike) -> NDArray[np.float64]:
    """Rotation matrices ``(..., 3, 3)`` of their first two columns ``(..., 6)``, by Gram–Schmidt.

    Raises
    ------
    InputError
        If two vectors are parallel, zero or not finite.

    Examples
    --------
    >>> np.allclose(ssdr.rigid.matrix_from_sixd([2, 0, 0, 1, 1, 0]), np.eye(3))
    True
    """
    d = _numbers(sixd, "sixd", 6)
    first, second = _scaled(d[..., :3], (-1,))[0], _scaled(d[..., 3:], (-1,))[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        a = first / np.linalg.norm(first, axis=-1, keepdims=True)
        b = second - (a * second).sum(axis=-1, keepdims=True) * a
        b = b / np.linalg.norm(b, axis=-1, keepdims=True)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise InputError("sixd", "pairs of finite, independent vectors", "NaN, Inf or parallel")
    return np.stack([a, b, np.cross(a, b)], axis=-1)
