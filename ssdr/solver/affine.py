"""Affine bones: all of all frames by one linear solve, and what keeps them sane.

With weights and rest pose given, the error of a frame is a quadratic in the
stacked transforms whose matrix U is the same for every frame and coordinate:
one Cholesky factor serves them all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from ..kernels.bones import LARGEST, SMALLEST, SPECK
from ..parallel import chunk_bounds, run_chunks, serial_blas
from ..rigid import nearest_rotation

__all__ = ["PATCH_RIDGE", "admissible", "flat_blocks", "leap_rigid", "ridge_blocks", "solve_affine"]

Array = NDArray[np.float64]

PATCH_RIDGE = 0.1  # for a first guess: few vertices, and they may lie in a plane
_RIDGE = 1e-4  # of a bone's own spread
_LEAP_RIDGE, _LEAPS = 1e-3, 2
_SWEEPS = 2  # Gauss–Seidel passes over the bones in a step: more are slower and settle further
_HALVINGS = (
    10  # of a move that is not admissible, to 1/512 of it; if that is not either, the bone stays
)


def admissible(old: Array, new: Array) -> NDArray[np.bool_]:
    """Whether bones (..., 3, 4) may go from old to new: not inside out, not flat, not huge."""
    a, b = old[..., :3], new[..., :3]
    upright = np.linalg.det(b) >= np.minimum(np.linalg.det(a), SMALLEST**3)
    size, most = (b * b).sum(axis=(-2, -1)), 3 * LARGEST**2
    return np.asarray(upright & (size <= np.maximum((a * a).sum(axis=(-2, -1)), most)))


def flat_blocks(u: Array) -> Array:
    """(B, B, 4, 4) blocks as a (4B, 4B) matrix, components first, as transforms are stacked."""
    n = len(u)
    return np.ascontiguousarray(u.transpose(2, 0, 3, 1)).reshape(4 * n, 4 * n)


def ridge_blocks(u: Array, ridge: float = _RIDGE) -> Array:
    """(B, 4, 4) metric of a change of each bone: Σ w² (ridge · spread |δL|² + ridge |δM c̃|²).

    c is the centroid of what the bone moves and the spread its mean squared extent
    in a direction, so that the ridge is small against every direction that the
    vertices determine and decides only in those that they do not.
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


def solve_affine(
    transforms: Array, u: Array, c: Array, locked: NDArray[np.bool_], *, ridge: float = _RIDGE
) -> None:
    """Least-squares affine transforms (F, B, 3, 4) of all frames (in place); no error rises.

    u (B, B, 4, 4) and c (F, 3, 4, B) are those of ``bone_sums``.  A ridge towards
    the present transforms decides what vertices in a plane, on a line or too few
    of them leave open.  Where a bone would turn inside out, or stretch beyond
    measure, its frame is swept bone by bone, each going as far towards its own
    optimum as it may.
    """
    n_frames, n_bones = transforms.shape[:2]
    free = np.tile(~locked, 4)
    if not free.any():
        return
    flat = flat_blocks(u)
    extra = np.zeros_like(u)
    extra[np.arange(n_bones), np.arange(n_bones)] = ridge_blocks(u, ridge)
    metric = flat + flat_blocks(extra)
    old = np.ascontiguousarray(transforms.transpose(0, 2, 3, 1)).reshape(3 * n_frames, 4 * n_bones)
    new = old.copy()
    with serial_blas():
        slope = (c.reshape(old.shape) - old @ flat)[:, free]
        new[:, free] += _solved(metric[np.ix_(free, free)], slope.T).T
    found = new.reshape(n_frames, 3, 4, n_bones).transpose(0, 3, 1, 2)
    bad = ~admissible(transforms, found).all(axis=1)
    transforms[~bad] = found[~bad]
    if bad.any():
        some = np.ascontiguousarray(transforms[bad])
        _sweep_guarded(some, flat, metric, c[bad], locked)
        transforms[bad] = some


def leap_rigid(transforms: Array, u: Array, c: Array, locked: NDArray[np.bool_]) -> None:
    """The rotations nearest to the affine optimum, frame by frame where they pay (in place).

    Sweeps take many rounds to carry a bone far along with its neighbours; this goes
    there at once, from sums as in :func:`solve_affine`.  What it leaves to rotations
    is for sweeps to settle.
    """
    n_frames, n_bones = transforms.shape[:2]
    free = np.tile(~locked, 4)
    if not free.any():
        return
    index = np.arange(n_bones)
    flat = flat_blocks(u)
    extra = np.zeros_like(u)
    extra[index, index] = ridge_blocks(u, _LEAP_RIDGE)
    metric = (flat + flat_blocks(extra))[np.ix_(free, free)]
    mass = np.maximum(u[index, index, 3, 3], 1e-300)
    centre = u[index, index, :3, 3] / mass[:, None]

    def stacked(m: Array) -> Array:
        return np.ascontiguousarray(m.transpose(0, 2, 3, 1)).reshape(3 * len(m), 4 * n_bones)

    def work(_: int, i: int, k: int) -> None:
        for _round in range(_LEAPS):
            old, target = stacked(transforms[i:k]), c[i:k].reshape(-1, 4 * n_bones)
            pulled = old @ flat
            new = old.copy()
            new[:, free] += _solved(metric, (target - pulled)[:, free].T).T
            found = new.reshape(k - i, 3, 4, n_bones).transpose(0, 3, 1, 2)
            near = transforms[i:k].copy()
            rotation = nearest_rotation(found[:, ~locked, :, :3])
            moved = found[:, ~locked] - np.pad(rotation, [(0, 0), (0, 0), (0, 0), (0, 1)])
            shift = np.einsum("tjab,jb->tja", moved[..., :3], centre[~locked]) + moved[..., 3]
            near[:, ~locked] = np.concatenate([rotation, shift[..., None]], axis=-1)
            hat = stacked(near)
            before = (old * (pulled - 2 * target)).reshape(k - i, -1).sum(axis=1)
            after = (hat * (hat @ flat - 2 * target)).reshape(k - i, -1).sum(axis=1)
            better = after < before
            transforms[i:k][better] = near[better]

    with serial_blas():
        run_chunks(work, chunk_bounds(n_frames, 32))


def _solved(metric: Array, slope: Array) -> Array:
    try:
        return np.asarray(cho_solve(cho_factor(metric, lower=True), slope))
    except np.linalg.LinAlgError:
        # bones as far away as numbers reach: what is lost in rounding stays as it is
        return np.asarray(np.linalg.pinv(metric, hermitian=True) @ slope)


def _sweep_guarded(
    transforms: Array, flat: Array, metric: Array, c: Array, locked: NDArray[np.bool_]
) -> None:
    n_frames, n_bones = transforms.shape[:2]
    hat = np.ascontiguousarray(transforms.transpose(0, 2, 3, 1)).reshape(n_frames, 3, 4 * n_bones)
    target = c.reshape(hat.shape)
    for _ in range(_SWEEPS):
        for j in np.flatnonzero(~locked):
            mine = np.arange(4) * n_bones + j
            slope = target[..., mine] - hat @ flat[:, mine]
            step = _solved(metric[np.ix_(mine, mine)], slope.reshape(-1, 4).T).T
            step = step.reshape(n_frames, 3, 4)
            now = hat[..., mine]
            for _ in range(_HALVINGS):
                moved = now + step
                over = ~admissible(now, moved)
                if not over.any():
                    break
                step[over] *= 0.5
            hat[..., mine] = np.where(over[:, None, None], now, moved)
    transforms[:] = hat.reshape(n_frames, 3, 4, n_bones).transpose(0, 3, 1, 2)
