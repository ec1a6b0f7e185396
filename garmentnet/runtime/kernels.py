"""Kernels of one frame: the bones' transforms, the skinned vertices.

Numbers are mostly passed and indexed one by one: views of rows cost more than the arithmetic.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ssdr.kernels.policy import inline, kernel

# As in torch: lengths by which vectors are divided are at least this.
_SHORT = 1e-8
_BLOCK = 64  # vertices whose blended transforms lie in the fastest cache


@inline
def _orthonormal(ax, ay, az, bx, by, bz):
    """Two columns made orthonormal by Gram–Schmidt (Zhou et al. 2019)."""
    size = max(math.sqrt(ax * ax + ay * ay + az * az), np.float32(_SHORT))
    ax, ay, az = ax / size, ay / size, az / size
    dot = ax * bx + ay * by + az * bz
    bx, by, bz = bx - dot * ax, by - dot * ay, bz - dot * az
    size = max(math.sqrt(bx * bx + by * by + bz * bz), np.float32(_SHORT))
    return ax, ay, az, bx / size, by / size, bz / size


@kernel
def add_bones(numbers, centres, weight, followed, bases, out):
    """Add weighted transforms (B, 12), given 6D rotations and positions of the centres (B, 9).

    They are relative to bases (N, 12), of which bone b has followed[b]; the last is the identity.
    """
    for b in range(len(numbers)):
        ax, ay, az, bx, by, bz = _orthonormal(
            numbers[b, 0], numbers[b, 1], numbers[b, 2],
            numbers[b, 3], numbers[b, 4], numbers[b, 5],
        )  # fmt: skip
        rows = (
            (ax, bx, ay * bz - az * by), (ay, by, az * bx - ax * bz), (az, bz, ax * by - ay * bx)
        )  # fmt: skip
        for a in range(3):
            j, i = followed[b], 4 * a
            u, v, w = bases[j, i], bases[j, i + 1], bases[j, i + 2]
            place = bases[j, i + 3] + u * numbers[b, 6] + v * numbers[b, 7] + w * numbers[b, 8]
            for c in range(3):
                x = u * rows[0][c] + v * rows[1][c] + w * rows[2][c]
                place -= x * centres[b, c]
                out[b, i + c] += weight * x
            out[b, i + 3] += weight * place


@kernel
def place(bones, joints, frame, out):
    """Write transforms (B + J, 12) from the rest pose to the world, relative to the frame's origin.

    Bones (B, 12) are in the moving frame, joints (J, 3, 4) in the world.  Relative to the frame's
    origin, float32 keeps its precision far from the world's origin.
    """
    n_bones = len(bones)
    for b in range(n_bones):
        for a in range(3):
            for c in range(4):
                out[b, 4 * a + c] = (
                    frame[a, 0] * bones[b, c]
                    + frame[a, 1] * bones[b, 4 + c]
                    + frame[a, 2] * bones[b, 8 + c]
                )
    for j in range(len(joints)):
        for a in range(3):
            for c in range(3):
                out[n_bones + j, 4 * a + c] = joints[j, a, c]
            out[n_bones + j, 4 * a + 3] = joints[j, a, 3] - frame[a, 3]


@kernel
def skin(m, origin, rest, indices, weights, detail, out):
    """Write positions v = Σ w_i M_i p + T d, T the blended rotation made orthonormal.

    rest and detail are (3, V), indices and weights (V, 8), transforms m (B, 12).  The loops over
    the numbers of a transform and over the vertices of a block are written so that the compiler
    vectorises them.
    """
    one: Any = np.float32(1)
    short: Any = np.float32(_SHORT)
    width = m.shape[1]
    blends = np.empty((_BLOCK, width), np.float32)
    s, o = np.empty((12, _BLOCK), np.float32), np.empty((3, _BLOCK), np.float32)
    for start in range(0, len(out), _BLOCK):
        n = min(_BLOCK, len(out) - start)
        for i in range(n):
            j = start + i
            b0, b1, b2, b3 = indices[j, 0], indices[j, 1], indices[j, 2], indices[j, 3]
            b4, b5, b6, b7 = indices[j, 4], indices[j, 5], indices[j, 6], indices[j, 7]
            w0, w1, w2, w3 = weights[j, 0], weights[j, 1], weights[j, 2], weights[j, 3]
            w4, w5, w6, w7 = weights[j, 4], weights[j, 5], weights[j, 6], weights[j, 7]
            for c in range(width):
                blends[i, c] = (
                    w0 * m[b0, c] + w1 * m[b1, c] + w2 * m[b2, c] + w3 * m[b3, c]
                    + w4 * m[b4, c] + w5 * m[b5, c] + w6 * m[b6, c] + w7 * m[b7, c]
                )  # fmt: skip
        for i in range(n):
            for c in range(12):
                s[c, i] = blends[i, c]
        for i in range(n):
            px, py, pz = rest[0, start + i], rest[1, start + i], rest[2, start + i]
            dx, dy, dz = detail[0, start + i], detail[1, start + i], detail[2, start + i]
            ax, ay, az, bx, by, bz = s[0, i], s[4, i], s[8, i], s[1, i], s[5, i], s[9, i]
            x = ax * px + bx * py + s[2, i] * pz + s[3, i]
            y = ay * px + by * py + s[6, i] * pz + s[7, i]
            z = az * px + bz * py + s[10, i] * pz + s[11, i]
            size = one / max(math.sqrt(ax * ax + ay * ay + az * az), short)
            ax, ay, az = ax * size, ay * size, az * size
            dot = ax * bx + ay * by + az * bz
            bx, by, bz = bx - dot * ax, by - dot * ay, bz - dot * az
            size = one / max(math.sqrt(bx * bx + by * by + bz * bz), short)
            bx, by, bz = bx * size, by * size, bz * size
            o[0, i] = x + ax * dx + bx * dy + (ay * bz - az * by) * dz
            o[1, i] = y + ay * dx + by * dy + (az * bx - ax * bz) * dz
            o[2, i] = z + az * dx + bz * dy + (ax * by - ay * bx) * dz
        for i in range(n):
            for a in range(3):
                out[start + i, a] = o[a, i] + origin[a, 3]
