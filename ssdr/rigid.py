"""Rigid motions: Kabsch, quaternions (xyzw) and the 6D representation, batched.

All functions work over any leading axes and in float64.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError

__all__ = [
    "kabsch",
    "matrix_from_quaternion",
    "matrix_from_sixd",
    "nearest_rotation",
    "quaternion_from_matrix",
    "sixd_from_matrix",
    "slerp",
    "unflip_quaternions",
]


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
        smallest that fits: the identity for coincident points, the turn from
        line to line for collinear ones.

    Raises
    ------
    InputError
        If shapes do not match, a number is not finite or a weight is negative.

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
    s, t = np.asarray(source, dtype=np.float64), np.asarray(target, dtype=np.float64)
    if s.ndim < 2 or s.shape[-1] != 3 or s.shape[-2] < 1:
        raise InputError("source", "an array of shape (..., N, 3)", f"shape {s.shape}")
    if t.ndim < 2 or t.shape[-2:] != s.shape[-2:]:
        raise InputError("target", f"an array of shape (..., {s.shape[-2]}, 3)", f"shape {t.shape}")
    w = np.ones(s.shape[-2]) if weights is None else np.asarray(weights, dtype=np.float64)
    if w.shape[-1:] != s.shape[-2:-1]:
        raise InputError("weights", f"shape (..., {s.shape[-2]})", f"shape {w.shape}")
    for name, array in (("source", s), ("target", t), ("weights", w)):
        if not np.isfinite(array).all():
            raise InputError(name, "finite numbers", "NaN or Inf")
    if (w < 0).any():
        raise InputError("weights", "numbers >= 0", f"{w.min()}")
    total = w.sum(axis=-1)[..., None]
    share = np.where(total > 0, w / np.where(total > 0, total, 1.0), 1.0 / s.shape[-2])
    s_mean = np.einsum("...n,...nc->...c", share, s)
    t_mean = np.einsum("...n,...nc->...c", share, t)
    moment = np.einsum(
        "...n,...na,...nb->...ab", share, t - t_mean[..., None, :], s - s_mean[..., None, :]
    )
    moment = np.where(total[..., None] > 0, moment, np.eye(3))
    rotation = nearest_rotation(moment)
    translation = t_mean - np.einsum("...ab,...b->...a", rotation, s_mean)
    return np.concatenate([rotation, translation[..., None]], axis=-1)


# Below this ratio of singular values, a moment says nothing about the turn around its axis.
_COLLINEAR = 1e-13


def nearest_rotation(moment: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation R, det R = +1, of largest tr(Rᵀ M): the nearest to M in the Frobenius norm.

    :func:`kabsch` takes M = Σ_i w_i t_i s_iᵀ, of points about their centroids.

    Parameters
    ----------
    moment : (..., 3, 3) float64 array
        M; finite.

    Returns
    -------
    (..., 3, 3) float64
        U diag(1, 1, ±1) Vᵀ of M = U S Vᵀ.  Where M does not determine the rotation, the
        smallest that fits: the identity for M = 0, the turn from line to line for rank 1.

    References
    ----------
    Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976;
    Umeyama, "Least-squares estimation of transformation parameters", 1991.

    Examples
    --------
    >>> np.allclose(ssdr.rigid.nearest_rotation(np.diag([3.0, 2.0, 1.0])), np.eye(3))
    True
    """
    u, s, vt = np.linalg.svd(moment)
    u = u.copy()
    u[..., :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[..., None]
    rotation = np.asarray(u @ vt)
    line = s[..., 1] <= _COLLINEAR * s[..., 0]
    if line.any():
        turn = _turn_between(vt[line][..., 0, :], u[line][..., :, 0])
        point = s[line][..., 0] == 0
        rotation[line] = np.where(point[..., None, None], np.eye(3), turn)
    return rotation


def _turn_between(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smallest rotations that carry unit vectors `a` to `b`, as two reflections."""
    half = a + b
    size = np.linalg.norm(half, axis=-1, keepdims=True)
    # Opposite vectors: any axis across them will do.
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

    Examples
    --------
    >>> half_turn = np.diag([-1.0, -1.0, 1.0])
    >>> np.allclose(np.abs(ssdr.rigid.quaternion_from_matrix(half_turn)), [0, 0, 1, 0])
    True
    """
    r = np.asarray(rotation, dtype=np.float64)
    if r.shape[-2:] != (3, 3):
        raise InputError("rotation", "an array of shape (..., 3, 3)", f"shape {r.shape}")
    diagonal = np.stack([r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]], axis=-1)
    trace = diagonal.sum(axis=-1)
    choice = np.argmax(np.concatenate([diagonal, trace[..., None]], axis=-1), axis=-1)
    x = np.stack(
        [
            1 + 2 * diagonal[..., 0] - trace,
            r[..., 0, 1] + r[..., 1, 0],
            r[..., 0, 2] + r[..., 2, 0],
            r[..., 2, 1] - r[..., 1, 2],
        ],
        axis=-1,
    )
    y = np.stack(
        [
            r[..., 0, 1] + r[..., 1, 0],
            1 + 2 * diagonal[..., 1] - trace,
            r[..., 1, 2] + r[..., 2, 1],
            r[..., 0, 2] - r[..., 2, 0],
        ],
        axis=-1,
    )
    z = np.stack(
        [
            r[..., 0, 2] + r[..., 2, 0],
            r[..., 1, 2] + r[..., 2, 1],
            1 + 2 * diagonal[..., 2] - trace,
            r[..., 1, 0] - r[..., 0, 1],
        ],
        axis=-1,
    )
    w = np.stack(
        [
            r[..., 2, 1] - r[..., 1, 2],
            r[..., 0, 2] - r[..., 2, 0],
            r[..., 1, 0] - r[..., 0, 1],
            1 + trace,
        ],
        axis=-1,
    )
    table = np.stack([x, y, z, w], axis=-2)
    q = np.take_along_axis(table, choice[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., 3:] < 0, -q, q))


def matrix_from_quaternion(quaternion: ArrayLike) -> NDArray[np.float64]:
    """Rotation matrices ``(..., 3, 3)`` of quaternions ``(..., 4)`` xyzw of any length but 0.

    Examples
    --------
    >>> half_turn = ssdr.rigid.matrix_from_quaternion([0, 0, 1, 0])
    >>> np.allclose(half_turn, np.diag([-1, -1, 1]))
    True
    """
    q = np.asarray(quaternion, dtype=np.float64)
    if q.shape[-1:] != (4,):
        raise InputError("quaternion", "an array of shape (..., 4)", f"shape {q.shape}")
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not (np.isfinite(norm) & (norm > 0)).all():
        raise InputError("quaternion", "finite quaternions that are not zero", "NaN, Inf or zero")
    x, y, z, w = np.moveaxis(q / norm, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def unflip_quaternions(quaternion: ArrayLike, *, axis: int = 0) -> NDArray[np.float64]:
    """Choose signs along `axis` (time) such that neighbours never flip.

    q and −q are the same rotation, but an engine that interpolates between keys
    of opposite sign takes the long way round.

    Examples
    --------
    >>> keys = np.array([[0, 0, 0, 1.0], [0, 0, 0, -1.0]])
    >>> np.allclose(ssdr.rigid.unflip_quaternions(keys), [0, 0, 0, 1])
    True
    """
    q = np.asarray(quaternion, dtype=np.float64)
    if q.ndim < 2 or q.shape[-1] != 4 or axis % q.ndim == q.ndim - 1:
        raise InputError("quaternion", "shape (..., 4) with a time axis", f"shape {q.shape}")
    q = np.moveaxis(q, axis, 0)
    flip = np.ones(q.shape[:-1])
    flip[1:] = np.where((q[1:] * q[:-1]).sum(axis=-1) < 0, -1.0, 1.0)
    return np.moveaxis(q * np.cumprod(flip, axis=0)[..., None], 0, axis)


# Sine of the angle below which sin(u·angle)/sin(angle) is replaced by u: both differ by less than
# rounding there, and equal quaternions would divide zero by zero.
_SMALL_SINE = 1e-8


def slerp(
    a: NDArray[np.float64], b: NDArray[np.float64], u: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Spherical linear interpolation of unit quaternions along the shorter arc.

    Parameters
    ----------
    a, b : (..., 4) float64
        Unit quaternions; they are not normalised again.
    u : (...) float64
        0 gives `a`, 1 gives `b` or −`b`, whichever is nearer to `a`.

    Returns
    -------
    (..., 4) float64

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
    r = np.asarray(rotation, dtype=np.float64)
    if r.shape[-2:] != (3, 3):
        raise InputError("rotation", "an array of shape (..., 3, 3)", f"shape {r.shape}")
    return np.concatenate([r[..., :, 0], r[..., :, 1]], axis=-1)


def matrix_from_sixd(sixd: ArrayLike) -> NDArray[np.float64]:
    """Rotation matrices ``(..., 3, 3)`` of two column vectors ``(..., 6)`` by Gram–Schmidt.

    Raises
    ------
    InputError
        If two vectors are parallel, zero or not finite.

    Examples
    --------
    >>> np.allclose(ssdr.rigid.matrix_from_sixd([2, 0, 0, 1, 1, 0]), np.eye(3))
    True
    """
    d = np.asarray(sixd, dtype=np.float64)
    if d.shape[-1:] != (6,):
        raise InputError("sixd", "an array of shape (..., 6)", f"shape {d.shape}")
    with np.errstate(invalid="ignore", divide="ignore"):
        a = d[..., :3] / np.linalg.norm(d[..., :3], axis=-1, keepdims=True)
        b = d[..., 3:] - (a * d[..., 3:]).sum(axis=-1, keepdims=True) * a
        b = b / np.linalg.norm(b, axis=-1, keepdims=True)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise InputError("sixd", "pairs of finite, independent vectors", "NaN, Inf or parallel")
    return np.stack([a, b, np.cross(a, b)], axis=-1)
