"""Kernels of one frame: a pose's features, the bones' transforms, the skinned vertices.

A pose state is one row of float64: the root's position in the first frame (3); then of the frame
before, the root's position (3), velocity (3) and rotation (9), and the features of the rotations.

Numbers are mostly passed and indexed one by one: views of rows cost more than the arithmetic.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ssdr.kernels.policy import inline, kernel

# Largest entry of |RRᵀ − I| that still counts as a rotation, as for networks in torch.
_ORTHOGONAL = 1e-3
# As in torch: a twist shorter than the first has no direction, and lengths by which vectors are
# divided are at least the second.
_UPSIDE_DOWN = 1e-12
_SHORT = 1e-8
_BLOCK = 64  # vertices whose blended transforms lie in the fastest cache


@inline
def _rigid(m, j):
    """Whether joint j is finite and rigid."""
    worst = 0.0
    for a in range(3):
        if not math.isfinite(m[j, a, 3]):
            return False
        for b in range(3):
            dot = m[j, a, 0] * m[j, b, 0] + m[j, a, 1] * m[j, b, 1] + m[j, a, 2] * m[j, b, 2]
            if a == b:
                dot -= 1.0
            if not math.isfinite(dot):
                return False
            worst = max(worst, abs(dot))
    det = (
        m[j, 0, 0] * (m[j, 1, 1] * m[j, 2, 2] - m[j, 1, 2] * m[j, 2, 1])
        - m[j, 0, 1] * (m[j, 1, 0] * m[j, 2, 2] - m[j, 1, 2] * m[j, 2, 0])
        + m[j, 0, 2] * (m[j, 1, 0] * m[j, 2, 1] - m[j, 1, 1] * m[j, 2, 0])
    )
    return worst <= _ORTHOGONAL and det > 0


@inline
def _rotation_vector(r, out, start):
    """Axis times angle, 0 to π, of a matrix (3, 3), by way of the quaternion's largest part."""
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    if trace >= max(r[0, 0], r[1, 1], r[2, 2]):
        w = 1 + trace
        x, y, z = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    elif r[0, 0] >= max(r[1, 1], r[2, 2]):
        w = r[2, 1] - r[1, 2]
        x, y, z = 1 + 2 * r[0, 0] - trace, r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]
    elif r[1, 1] >= r[2, 2]:
        w = r[0, 2] - r[2, 0]
        x, y, z = r[0, 1] + r[1, 0], 1 + 2 * r[1, 1] - trace, r[1, 2] + r[2, 1]
    else:
        w = r[1, 0] - r[0, 1]
        x, y, z = r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], 1 + 2 * r[2, 2] - trace
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 0.0
    if sine > 0:
        scale = 2 * math.atan2(sine, abs(w)) / sine * (1.0 if w >= 0 else -1.0)
    out[start], out[start + 1], out[start + 2] = scale * x, scale * y, scale * z


@kernel
def all_rigid(m):
    """Whether all joints (J, 3, 4) are finite and rigid."""
    for j in range(len(m)):  # noqa: SIM110
        if not _rigid(m, j):
            return False
    return True


@kernel
def moving_frame(m, rest, kind, frame):
    """Write the moving frame (3, 4) of the prediction, by `kind`: 0 world, 1 root, 2 heading."""
    frame[:] = 0.0
    for a in range(3):
        frame[a, a] = 1.0
    if kind == 0:
        return
    for a in range(3):
        place = m[0, a, 3]
        for b in range(3):
            place += m[0, a, b] * rest[0, b]
        frame[a, 3] = place
    if kind == 1:
        frame[:, :3] = m[0, :, :3]
        return
    s, c = m[0, 0, 2] - m[0, 2, 0], m[0, 0, 0] + m[0, 2, 2]
    size = math.hypot(s, c)
    if size > _UPSIDE_DOWN:
        s, c = s / size, c / size
        frame[0, 0], frame[0, 2], frame[2, 0], frame[2, 2] = c, s, -s, c


@kernel
def pose_features(m, rest, parents, read, options, fps, begins, state, new, out):
    """Write the features and the new pose state for joints (J, 3, 4).

    `options` are five flags: 6D rotations (else rotation vectors), root rotation relative to the
    heading, and whether translation, velocities and root motion are among the features.
    """
    sixd, free, translation, velocities, motion = options
    heading, root, base = np.empty((3, 4)), np.empty((3, 4)), np.empty((3, 4))
    moving_frame(m, rest, 2, heading)
    moving_frame(m, rest, 1, root)
    moving_frame(m, rest, 2 if free else 0, base)
    local = np.empty((3, 3))
    each = 6 if sixd else 3
    first = 3 if translation else 0
    for k in range(len(read)):
        j = read[k]
        above = m[parents[j]] if parents[j] >= 0 else base
        for a in range(3):
            for b in range(3):
                local[a, b] = (
                    above[0, a] * m[j, 0, b] + above[1, a] * m[j, 1, b] + above[2, a] * m[j, 2, b]
                )
        if sixd:
            for a in range(3):
                new[18 + 6 * k + a], new[21 + 6 * k + a] = local[a, 0], local[a, 1]
        else:
            _rotation_vector(local, new, 18 + 3 * k)
    size = each * len(read)
    for a in range(3):
        new[a] = root[a, 3] if begins else state[a]
        new[3 + a] = root[a, 3]
        new[6 + a] = 0.0 if begins else (root[a, 3] - state[3 + a]) * fps
        for b in range(3):
            new[9 + 3 * a + b] = m[0, a, b]
        if translation:
            out[a] = root[a, 3] - new[a]
    for i in range(size):
        out[first + i] = new[18 + i]
        if velocities:
            out[first + size + i] = 0.0 if begins else (new[18 + i] - state[18 + i]) * fps
    if motion:
        at = first + (2 * size if velocities else size)
        # The root's rotation since the frame before, R R'ᵀ.
        for a in range(3):
            for b in range(3):
                local[a, b] = 1.0 if a == b else 0.0
                if not begins:
                    i = 9 + 3 * b
                    local[a, b] = (
                        m[0, a, 0] * state[i]
                        + m[0, a, 1] * state[i + 1]
                        + m[0, a, 2] * state[i + 2]
                    )
        spin = np.empty(3)
        _rotation_vector(local, spin, 0)
        for a in range(3):
            v, c, w = 0.0, 0.0, 0.0
            for b in range(3):
                h = heading[b, a]
                v += h * new[6 + b]
                c += h * (new[6 + b] - (0.0 if begins else state[6 + b]))
                w += h * spin[b] * fps
            out[at + a], out[at + 3 + a] = v, c * fps
            out[at + 6 + a], out[at + 9 + a] = w, w * w


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
def add_bones(numbers, centres, weight, out):
    """Add weighted transforms (B, 12), given 6D rotations and positions of the centres (B, 9)."""
    for b in range(len(numbers)):
        ax, ay, az, bx, by, bz = _orthonormal(
            numbers[b, 0], numbers[b, 1], numbers[b, 2],
            numbers[b, 3], numbers[b, 4], numbers[b, 5],
        )  # fmt: skip
        rows = (
            (ax, bx, ay * bz - az * by), (ay, by, az * bx - ax * bz), (az, bz, ax * by - ay * bx)
        )  # fmt: skip
        for a in range(3):
            x, y, z = rows[a]
            shift = x * centres[b, 0] + y * centres[b, 1] + z * centres[b, 2]
            out[b, 4 * a] += weight * x
            out[b, 4 * a + 1] += weight * y
            out[b, 4 * a + 2] += weight * z
            out[b, 4 * a + 3] += weight * (numbers[b, 6 + a] - shift)


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
