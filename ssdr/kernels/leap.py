"""Kernel of a leap: a Gauss–Newton step of all rigid bones of a frame together."""

from __future__ import annotations

import numpy as np

from .bones import turn_bone
from .policy import inline, kernel


@inline
def value_of(m, target, flat, stacked, product):
    """Set product (3, 4B) to bones m (B, 3, 4) times flat; return their error up to a constant."""
    n_bones = len(m)
    for j in range(n_bones):
        for c in range(3):
            for d in range(4):
                stacked[c, d * n_bones + j] = m[j, c, d]
    np.dot(stacked, flat, product)
    value = 0.0
    for c in range(3):
        for k in range(4 * n_bones):
            value += stacked[c, k] * (product[c, k] - 2.0 * target[c, k])
    return value


@inline
def turned_moments(a, b, w, turn, block):
    """Set block (6, 6) of the matrix of a leap to that of bones a, b (3, 4) with moments w."""
    for c in range(3):
        for d in range(3):
            turn[c, d] = a[0, c] * b[0, d] + a[1, c] * b[1, d] + a[2, c] * b[2, d]
    for s in range(3):
        f, g = (s + 1) % 3, (s + 2) % 3
        for t in range(3):
            h, k = (t + 1) % 3, (t + 2) % 3
            block[s, t] = (w[g, k] * turn[f, h] - w[g, h] * turn[f, k]) - (
                w[f, k] * turn[g, h] - w[f, h] * turn[g, k]
            )
            block[s, 3 + t] = w[f, 3] * turn[g, t] - w[g, 3] * turn[f, t]
            block[3 + s, t] = w[3, h] * turn[s, k] - w[3, k] * turn[s, h]
            block[3 + s, 3 + t] = w[3, 3] * turn[s, t]


@kernel
def leap_bones(transforms, target, u, flat, still, scale, damping):
    """Take a Gauss–Newton step of all bones of a frame together, frame by frame.

    transforms  (F, B, 3, 4)  float64  bones about their centres c̃: columns R and M c̃, updated
    target      (F, 3, 4B)    float64  Σ_i w_j v_i q̃ᵀ of points q about the bones' centres, in
    u           (B, B, 4, 4)  float64  Σ_i w_j w_k q̃q̃ᵀ, about the centre of j, then that of k, in
    flat        (4B, 4B)      float64  u in the order of the stacked transforms, in
    still       (B,)          bool     bones that do not move, in
    scale       (B, 6)        float64  unit of each unknown: a rotation and a translation in
                                       the bone's axes, in

    A frame starts from the bones of the previous frame if these have less error than its own.
    `damping` is added to the diagonal of the matrix.  No error rises.
    """
    n_bones = transforms.shape[1]
    size = 6 * n_bones
    moved = np.empty((n_bones, 3, 4))
    stacked, product = np.empty((3, 4 * n_bones)), np.empty((3, 4 * n_bones))
    matrix = np.zeros((size, size), dtype=np.float32)
    x = np.empty(size, dtype=np.float32)
    block, turn, old = np.empty((6, 6)), np.empty((3, 3)), np.empty(3)
    for t in range(len(transforms)):
        m, goal = transforms[t], target[t]
        value = value_of(m, goal, flat, stacked, product)
        if t > 0:
            for j in range(n_bones):
                moved[j] = m[j] if still[j] else transforms[t - 1, j]
            before = value_of(moved, goal, flat, stacked, product)
            if before < value:
                value = before
                m[:] = moved
            else:
                value_of(m, goal, flat, stacked, product)
        for j in range(n_bones):
            i = 6 * j
            for s in range(3):
                f, g = (s + 1) % 3, (s + 2) % 3
                x[i + s] = x[i + 3 + s] = 0.0
                if still[j]:
                    continue
                for c in range(3):
                    at = f * n_bones + j, g * n_bones + j, 3 * n_bones + j
                    x[i + s] += scale[j, s] * (
                        m[j, c, g] * (goal[c, at[0]] - product[c, at[0]])
                        - m[j, c, f] * (goal[c, at[1]] - product[c, at[1]])
                    )
                    x[i + 3 + s] += (
                        scale[j, 3 + s] * m[j, c, s] * (goal[c, at[2]] - product[c, at[2]])
                    )
            for k in range(j, n_bones):
                if u[j, k, 3, 3] == 0.0 or still[j] or still[k]:
                    continue
                turned_moments(m[j], m[k], u[j, k], turn, block)
                for s in range(6):
                    for d in range(6):
                        matrix[6 * k + d, i + s] = scale[j, s] * block[s, d] * scale[k, d]
            for s in range(6):
                matrix[i + s, i + s] = 1.0 if still[j] else matrix[i + s, i + s] + damping
        factor = np.linalg.cholesky(matrix)
        for p in range(size):
            x[p] = (x[p] - np.dot(factor[p, :p], x[:p])) / factor[p, p]
        for p in range(size - 1, -1, -1):
            x[p] /= factor[p, p]
            row, left = factor[p, :p], x[:p]
            for c in range(p):
                left[c] -= row[c] * x[p]
        moved[:] = m
        for j in range(n_bones):
            if still[j]:
                continue
            i, s = 6 * j, scale[j]
            for c in range(3):
                for d in range(3):
                    moved[j, c, 3] += m[j, c, d] * s[3 + d] * x[i + 3 + d]
            turn_bone(moved[j], s[0] * x[i], s[1] * x[i + 1], s[2] * x[i + 2], turn, old)
        if value_of(moved, goal, flat, stacked, product) < value:
            m[:] = moved
