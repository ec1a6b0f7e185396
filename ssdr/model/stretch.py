"""Stretching bones as rotations and scales, with axes that stay steady from frame to frame."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from .rigid import matrix_from_quaternion, quaternion_from_matrix, slerp

Array = NDArray[np.float64]


def _turns_of_axes() -> Array:
    """The 24 rotations (24, 3, 3) that map axes to axes up to sign, the identity first."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            turn = np.eye(3)[list(order)] * np.array(signs)
            if np.linalg.det(turn) > 0:
                found.append(turn)
    return np.stack(found)


_TURNS = _turns_of_axes()


def steady_axes(matrices: Array) -> tuple[Array, Array, Array]:
    """Rotations U, factors S and rotations Vᵀ of matrices M = U S Vᵀ whose determinant is positive.

    The singular value decomposition leaves the order and the signs of the axes open.  The choice
    matters between frames, where U and Vᵀ are interpolated along arcs and S linearly.  In each
    frame it is the one with which the matrix midway from the previous frame comes closest to the
    mean of the two frames' matrices.  As only choices relative to the previous frame matter, this
    is the best choice for the whole clip.

    Parameters
    ----------
    matrices : (F, B, 3, 3) array

    Returns
    -------
    (F, B, 3, 3), (F, B, 3) and (F, B, 3, 3) arrays
    """
    u, s, vt = np.linalg.svd(matrices)
    sign = np.linalg.det(u)  # that of Vᵀ, too
    u[..., :, 2] *= sign[..., None]
    vt[..., 2, :] *= sign[..., None]
    for frame in range(1, len(matrices)):
        mean = (matrices[frame - 1] + matrices[frame]) / 2
        turns = _TURNS[:, None]
        ahead = u[frame] @ turns, turns.swapaxes(2, 3) @ vt[frame]
        factors = np.einsum("cbij,bj->cbi", np.abs(turns.swapaxes(2, 3)), s[frame])
        before = (u[frame - 1], vt[frame - 1])
        first, last = (_midway(a, b) for a, b in zip(before, ahead, strict=True))
        middle = (first * ((s[frame - 1] + factors) / 2)[..., None, :]) @ last
        best = ((middle - mean) ** 2).sum(axis=(2, 3)).argmin(axis=0)
        own = np.arange(len(best))
        u[frame], vt[frame], s[frame] = ahead[0][best, own], ahead[1][best, own], factors[best, own]
    return u, s, vt


def _midway(a: Array, b: Array) -> Array:
    """Rotations midway between (B, 3, 3) and (24, B, 3, 3)."""
    p, q = np.broadcast_arrays(quaternion_from_matrix(a), quaternion_from_matrix(b))
    return matrix_from_quaternion(slerp(p, q, np.full(p.shape[:-1], 0.5)))
