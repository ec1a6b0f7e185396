"""Affine transforms of all bones by one linear solve, and bounds that keep them invertible.

With weights and rest pose given, the error of a frame is a quadratic in the stacked transforms.
Its matrix U is the same for every frame and axis, so that one Cholesky factor serves them all.
"""

from __future__ import annotations

import contextlib

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ..common.parallel import chunk_bounds, run_chunks, serial_blas
from ..kernels.bones import LARGEST, SMALLEST, SPECK
from ..kernels.leap import leap_bones
from .moments import stack_blocks
from .trajectories import Array, stack_transforms, unstack_transforms

# Strengths of the ridge penalty: for patches (of few vertices, which may lie in a plane), and for a
# step of the alternation.
PATCH_RIDGE, _RIDGE = 0.1, 1e-4
# Damping of a leap, relative to the diagonal: above the rounding of its factor in float32.
_DAMPING = 1e-3
_MARCH = 48  # frames of which each may start from the previous one
_SWEEPS = 2  # Gauss–Seidel passes over the bones: more take longer and converge further
_HALVINGS = 10  # most halvings of an inadmissible move; if that is not enough, the bone stays


def admissible(old: Array, new: Array) -> NDArray[np.bool_]:
    """Mask (...) of the bones (..., 3, 4) whose new transform is not reflected, flat or too large.

    Where the old transform breaks a bound already, a new one that is no worse is admissible, too.
    """
    a, b = old[..., :3], new[..., :3]
    upright = np.linalg.det(b) >= np.minimum(np.linalg.det(a), SMALLEST**3)
    size, most = (b * b).sum(axis=(-2, -1)), 3 * LARGEST**2
    return np.asarray(upright & (size <= np.maximum((a * a).sum(axis=(-2, -1)), most)))


def ridge_blocks(u: Array, ridge: float) -> Array:
    """Matrices (B, 4, 4) of a quadratic ridge penalty on the change δM = [δL, δT] of each bone.

    The penalty is Σ_i w_i² · ridge · (spread |δL|² + |δM c̃|²), where c is the centroid of the
    vertices that the bone moves and spread is their variance along an axis, averaged over the axes.
    It is small beside the error in every direction of δM that the vertices determine, and so
    decides only the other directions.
    """
    n = len(u)
    own = u[np.arange(n), np.arange(n)]
    mass = np.maximum(own[:, 3, 3], 1e-12 * max(float(own[:, 3, 3].max()), 1e-300))
    centre = own[:, :, 3] / mass[:, None]
    centre[:, 3] = 1.0
    spread = np.einsum("jcc->j", own[:, :3, :3]) / mass - (centre[:, :3] ** 2).sum(axis=1)
    out = ridge * centre[:, :, None] * centre[:, None, :]
    out[:, :3, :3] += (ridge * np.maximum(spread, 0.0) / 3 + SPECK)[:, None, None] * np.eye(3)
    return np.asarray(out * mass[:, None, None])


def stack_diagonal(blocks: Array) -> Array:
    """Block-diagonal matrix (4B, 4B) of blocks (B, 4, 4), in the order of :func:`stack_blocks`."""
    n = len(blocks)
    full = np.zeros((n, n, 4, 4))
    full[np.arange(n), np.arange(n)] = blocks
    return stack_blocks(full)


def solve_affine(transforms: Array, u: Array, c: Array, *, ridge: float = _RIDGE) -> None:
    """Fit affine transforms (F, B, 3, 4) to all frames by least squares (in place).

    No frame's error rises.  If a bone's vertices are too few, or lie in a plane or on a line, they
    do not determine its transform; a ridge penalty on the change of the transform then decides.  In
    frames in which a bone would become inadmissible (see :func:`admissible`), the bones are solved
    one by one, and each goes as far towards its optimum as is admissible.

    Parameters
    ----------
    u : (B, B, 4, 4) array
    c : (F, 3, 4, B) array
        Both as :func:`~ssdr.solver.moments.bone_sums` returns them.
    ridge : float
        Strength of the ridge penalty, as in :func:`ridge_blocks`.
    """
    flat = stack_blocks(u)
    metric = flat + stack_diagonal(ridge_blocks(u, ridge))
    old = stack_transforms(transforms)
    with serial_blas():
        slope = c.reshape(old.shape) - old @ flat
        found = unstack_transforms(old + _solved(metric, slope.T).T, len(u))
    bad = ~admissible(transforms, found).all(axis=1)
    transforms[~bad] = found[~bad]
    if bad.any():
        some = np.ascontiguousarray(transforms[bad])
        _sweep_admissible(some, flat, metric, c[bad])
        transforms[bad] = some


def leap_rigid(transforms: Array, u: Array, c: Array) -> None:
    """Take a Gauss–Newton step of all rigid bones of a frame together, in every frame (in place).

    Gauss–Seidel sweeps take hundreds of rounds to move a bone far together with its neighbours.  A
    frame starts from the moved bones of the previous frame if these fit it better than its own.  No
    frame's error rises.  The parameters are those of :func:`solve_affine`.
    """
    n_bones, index = transforms.shape[1], np.arange(transforms.shape[1])
    mass = u[index, index, 3, 3]
    still = ~(mass > 0)
    # A rotation about the centroid of what a bone moves does not move the centroid.
    centre = u[index, index, :3, 3] / np.where(mass > 0, mass, 1.0)[:, None]
    shift = np.tile(np.eye(4), (n_bones, 1, 1))
    shift[:, :3, 3] = -centre
    moments = np.einsum("jab,jkbc,kdc->jkad", shift, u, shift, optimize=True)
    flat = stack_blocks(moments)
    spread = np.einsum("jaa->ja", moments[index, index])
    inertia = spread[:, :3].sum(axis=1, keepdims=True) - spread[:, :3]
    own = np.concatenate([np.maximum(inertia, SPECK * mass[:, None]), spread[:, [3, 3, 3]]], axis=1)
    scale = 1 / np.sqrt(np.where(still[:, None], 1.0, own))

    def work(_: int, i: int, k: int) -> None:
        moved = transforms[i:k].copy()
        moved[..., 3] += np.einsum("tjab,jb->tja", moved[..., :3], centre)
        target = np.einsum("tadj,jed->taej", c[i:k], shift).reshape(k - i, 3, -1)
        # if rounding has made a matrix indefinite, further frames stay
        with contextlib.suppress(np.linalg.LinAlgError):
            leap_bones(moved, target, moments, flat, still, scale, _DAMPING)
        moved[..., 3] -= np.einsum("tjab,jb->tja", moved[..., :3], centre)
        transforms[i:k, ~still] = moved[:, ~still]

    with serial_blas():
        run_chunks(work, chunk_bounds(len(transforms), _MARCH))


def _solved(metric: Array, slope: Array) -> Array:
    try:
        return np.asarray(cho_solve(cho_factor(metric, lower=True), slope))
    except np.linalg.LinAlgError:
        # rounding at bones very far away has made the matrix indefinite
        return np.asarray(np.linalg.pinv(metric, hermitian=True) @ slope)


def _sweep_admissible(transforms: Array, flat: Array, metric: Array, c: Array) -> None:
    """Move one bone after the other towards its optimum as far as is admissible (in place)."""
    n_frames, n_bones = transforms.shape[:2]
    stacked = stack_transforms(transforms).reshape(n_frames, 3, 4 * n_bones)
    target = c.reshape(stacked.shape)
    for _ in range(_SWEEPS):
        for j in range(n_bones):
            mine = np.arange(4) * n_bones + j
            slope = target[..., mine] - stacked @ flat[:, mine]
            step = _solved(metric[np.ix_(mine, mine)], slope.reshape(-1, 4).T).T
            step = step.reshape(n_frames, 3, 4)
            now = stacked[..., mine]
            for _ in range(_HALVINGS):
                moved = now + step
                over = ~admissible(now, moved)
                if not over.any():
                    break
                step[over] *= 0.5
            stacked[..., mine] = np.where(over[:, None, None], now, moved)
    transforms[:] = unstack_transforms(stacked, n_bones)
