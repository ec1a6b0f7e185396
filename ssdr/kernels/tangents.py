"""Kernels of the polish beyond the vertex step: Schur complement, tangents, moves.

The tangent (ω, τ) of a bone acts from the right: δM = M [[ω]× τ; 0 0].
"""

from __future__ import annotations

import numpy as np

from .frames import quaternion_matrix
from .policy import kernel
from .vertices import against, store


@kernel
def schur_vertices(
    cross, rest, joints, weights, importance, keep_weights, inverse, gradient, share,
    step, total, move_rest, first, last,
):  # fmt: skip
    """Eliminate vertices first..last from the normal equations.

    cross (B, B, 4, 4) is Mᵀ δM summed over frames.  Writes ``step`` (V, D), the
    inverse times (H_vm δM + share·gradient), and adds to ``total`` (B, B, 4, 4) its image
    Σ δa aᵀ.
    """
    n_keep = joints.shape[1]
    image = np.empty((n_keep, 4))
    p4 = np.empty(4)
    d4 = np.empty(4)
    b = np.empty(n_keep + 2)
    p4[3] = 1.0
    for i in range(first, last):
        n = 0
        while n < n_keep and weights[i, n] > 0.0:
            n += 1
        for c in range(3):
            p4[c] = rest[i, c]
        for q in range(n):
            for d in range(4):
                image[q, d] = 0.0
            for s in range(n):
                block = cross[joints[i, q], joints[i, s]]
                w = weights[i, s]
                for d in range(4):
                    image[q, d] += w * against(block, d, p4)
        k = 0 if keep_weights[i] else n - 1
        base = against(image, 0, p4)
        for q in range(k):
            b[q] = against(image, q + 1, p4) - base
        size = k
        if move_rest:
            size = k + 3
            for c in range(3):
                b[k + c] = 0.0
                for q in range(n):
                    b[k + c] += weights[i, q] * image[q, c]
        for q in range(size):
            b[q] += share * gradient[i, q]
        sum_w = 0.0
        for q in range(size):
            value = 0.0
            for s in range(size):
                value += inverse[i, q, s] * b[s]
            step[i, q] = value
            if q < k:
                sum_w += value
        for q in range(size, n_keep + 2):
            step[i, q] = 0.0
        for q in range(n):
            dw = 0.0
            if k > 0:
                dw = -sum_w if q == 0 else step[i, q - 1]
            w = weights[i, q]
            for d in range(3):
                d4[d] = dw * p4[d]
                if move_rest:
                    d4[d] += w * step[i, k + d]
            d4[3] = dw
            for s in range(n):
                c = importance[i] * weights[i, s]
                block = total[joints[i, q], joints[i, s]]
                for d in range(4):
                    v = c * d4[d]
                    for e in range(4):
                        block[d, e] += v * p4[e]


@kernel
def apply_vertex_step(step, size, rest, joints, weights, keep_weights, move_rest, first, last):
    """Move weights and rest position by −size·step, weights back onto the simplex."""
    n_keep = joints.shape[1]
    w = np.empty(n_keep)
    ids = np.empty(n_keep, dtype=np.int32)
    for i in range(first, last):
        n = 0
        while n < n_keep and weights[i, n] > 0.0:
            ids[n] = joints[i, n]
            w[n] = weights[i, n]
            n += 1
        k = 0 if keep_weights[i] else n - 1
        if k > 0:
            total = 0.0
            for q in range(1, n):
                w[q] = max(w[q] - size * step[i, q - 1], 0.0)
                total += w[q]
            w[0] = max(1.0 - total, 0.0)
            store(ids, w, n, joints[i], weights[i])
        if move_rest:
            for c in range(3):
                rest[i, c] -= size * step[i, k + c]


@kernel
def tangent_image(transforms, x, scale, out, first, last):
    """out (3F, 4, B) = the change of the stacked transforms under tangents x (F, B, 6)."""
    for t in range(first, last):
        s = scale[t]
        for j in range(transforms.shape[1]):
            m = transforms[t, j]
            for c in range(3):
                row = out[3 * t + c]
                row[3, j] = 0.0
                for d in range(3):
                    e, f = (d + 1) % 3, (d + 2) % 3
                    row[d, j] = s * (m[c, e] * x[t, j, f] - m[c, f] * x[t, j, e])
                    row[3, j] += s * m[c, d] * x[t, j, 3 + d]


@kernel
def tangent_pullback(transforms, g, scale, out, first, last):
    """out (F, B, 6) = transpose of :func:`tangent_image` applied to g (3F, 4, B)."""
    for t in range(first, last):
        s = scale[t]
        for j in range(transforms.shape[1]):
            m = transforms[t, j]
            o = out[t, j]
            for d in range(6):
                o[d] = 0.0
            for c in range(3):
                row = g[3 * t + c]
                for d in range(3):
                    e, f = (d + 1) % 3, (d + 2) % 3
                    o[d] += s * (m[c, f] * row[e, j] - m[c, e] * row[f, j])
                    o[3 + d] += s * m[c, d] * row[3, j]


@kernel
def move_bones(transforms, x, locked, first, last):
    """M ← M exp(x) for frames first..last, rotations kept orthonormal."""
    turn = np.empty((3, 3))
    old = np.empty(3)
    for t in range(first, last):
        for j in range(transforms.shape[1]):
            if locked[j]:
                continue
            m = transforms[t, j]
            quaternion_matrix(1.0, 0.5 * x[t, j, 0], 0.5 * x[t, j, 1], 0.5 * x[t, j, 2], turn)
            for c in range(3):
                for d in range(3):
                    m[c, 3] += m[c, d] * x[t, j, 3 + d]
                    old[d] = m[c, d]
                for d in range(3):
                    m[c, d] = 0.0
                    for e in range(3):
                        m[c, d] += old[e] * turn[e, d]
