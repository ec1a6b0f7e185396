"""Kernels of a pose: whether it is rigid, its moving frame, its features.

A pose state is one row of float64: the root's position in the first frame (3); then of the frame
before, the root's position (3), velocity (3) and rotation (9), and the features of the rotations.

Numbers are mostly passed and indexed one by one: views of rows cost more than the arithmetic.
"""

from __future__ import annotations

import math

import numpy as np

from ssdr.kernels.policy import inline, kernel

# Largest entry of |RRᵀ − I| that still counts as a rotation, as for `check_joints`.
_ORTHOGONAL = 1e-3
# Length of the twist's sine and cosine, at most 2, below which the body is upside down.
_UPSIDE_DOWN = 1e-12


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
def pose_features(m, rest, parents, read, options, kind, fps, begins, before, states, out, frames):
    """Write features (F, D), states after each frame and moving frames for joints (F, J, 3, 4).

    `before` is the state before the first frame; `begins`: there is none, and the motion starts
    from rest.  `kind` numbers the moving frames, `options` are those of :func:`_one`.
    """
    for f in range(len(m)):
        state = before if f == 0 else states[f - 1]
        first = begins and f == 0
        _one(m[f], rest, parents, read, options, fps, first, state, states[f], out[f])
        moving_frame(m[f], rest, kind, frames[f])


@inline
def _one(m, rest, parents, read, options, fps, begins, state, new, out):
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
