"""Kernels of the bones in the polish: Schur complement, tangents, and what a step moves.

The tangent (ω, τ) of a bone changes its transform by δM = M [[ω]× τ; 0 0].
"""

from __future__ import annotations

import numpy as np

from .bones import turn_bone
from .policy import kernel
from .vertices import read_influences, store


@kernel
def answer_bones(
    cross,
    start,
    bones,
    count,
    slot,
    points,
    weights,
    free,
    inverse,
    gradient,
    share,
    step,
    move_rest,
    first,
    last,
):
    """Compute the steps with which the vertices in groups first..last answer a change of the bones.

    cross       (B, B, 4, 4)  real     for bones k, j: (Mⱼᵀ δMₖ)ᵀ summed over frames, in
    start       (G + 1,)      integer  start[g]..start[g + 1]: vertices of group g, in
    bones       (G, K)        integer  bones that all vertices of a group use, in
    count       (G,)          integer  number of bones of each group, in
    slot        (V, K)        integer  column in the model's weights of each of `weights`, in
    points      (V, P, 4)     real     points p̃ of each vertex: its rest position (p, 1) and, if it
                                       has one, its normal (l n, 0), in
    weights     (V, K)        real     weights in the order of the group's bones, in
    free        (V,)          bool     vertices whose weights may change, in
    inverse     (V, D, D)     real     inverse of the Gauss–Newton matrix, in
    gradient    (V, D)        real     half gradient of the error, in
    step        (V, D)        real     inverse times (H_vm δM + share · gradient), out

    ``real`` is float32 or float64, the same for all these arrays.
    """
    real = inverse.dtype
    n_keep = bones.shape[1]
    n_points = points.shape[1]
    n_unknowns = inverse.shape[1]
    # Rows are padded to whole vectors; entries beyond 4·count are finite and never used.
    width = 16 * ((4 * n_keep + 15) // 16)
    block = np.zeros((4 * n_keep, width), dtype=real)
    image = np.empty(width, dtype=real)
    along = np.empty(n_keep, dtype=real)
    zero = along.dtype.type(0)
    b = np.empty(n_unknowns, dtype=real)
    for g in range(first, last):
        n = count[g]
        width = 16 * ((4 * n + 15) // 16)
        for s in range(n):
            for q in range(n):
                m = cross[bones[g, s], bones[g, q]]
                for e in range(4):
                    for d in range(4):
                        block[4 * s + e, 4 * q + d] = m[e, d]
        for i in range(start[g], start[g + 1]):
            k = n - 1 if free[i] else 0
            size = k
            along[:n] = 0.0
            for e in range(n_points):
                p0, p1, p2, p3 = points[i, e, 0], points[i, e, 1], points[i, e, 2], points[i, e, 3]
                image[:width] = 0.0
                for s in range(n):
                    w, u = weights[i, s], 4 * s
                    v0, v1, v2, v3 = w * p0, w * p1, w * p2, w * p3
                    for t in range(width):
                        image[t] += (
                            v0 * block[u, t]
                            + v1 * block[u + 1, t]
                            + v2 * block[u + 2, t]
                            + v3 * block[u + 3, t]
                        )
                g0 = g1 = g2 = zero
                for q in range(n):
                    w, u = weights[i, q], 4 * q
                    v0, v1, v2 = image[u], image[u + 1], image[u + 2]
                    g0 += w * v0
                    g1 += w * v1
                    g2 += w * v2
                    along[slot[i, q]] += v0 * p0 + v1 * p1 + v2 * p2 + image[u + 3] * p3
                if e > 0 or move_rest:
                    b[size], b[size + 1], b[size + 2] = g0, g1, g2
                    size += 3
            for q in range(k):
                b[q] = along[q + 1] - along[0]
            for q in range(size):
                b[q] += share * gradient[i, q]
            for s in range(n_unknowns):
                value = zero
                for q in range(size):
                    value += b[q] * inverse[i, s, q]
                step[i, s] = value


@kernel
def effect_on_bones(
    start,
    bones,
    count,
    slot,
    points,
    weights,
    free,
    inverse,
    importance,
    change,
    step,
    total,
    move_rest,
    first,
    last,
):
    """Add up the effect on the bones of the steps of vertices in groups first..last.

    start..inverse                     as in :func:`answer_bones`, in
    importance  (V,)          real     factor of each vertex's error, in
    change      (V, 3)        real     changes of the right sides of rest positions, or (0, 3), in
    step        (V, D)        real     steps of the vertices, to which that of `change` is added
    total       (B, B, 4, 4)  float64  Σ_i a δaᵀ, in the layout of `cross`, times importance, where
                                       a is w p̃ of a bone and δa its change, added to

    Groups are summed in ``real``.
    """
    real = inverse.dtype
    n_keep = bones.shape[1]
    n_points = points.shape[1]
    n_unknowns = inverse.shape[1]
    coupled = len(change) > 0
    # as in answer_bones
    width = 16 * ((4 * n_keep + 15) // 16)
    sums = np.zeros((4 * n_keep, width), dtype=real)
    a = np.zeros((4, 4 * n_keep), dtype=real)
    delta = np.zeros((4, width), dtype=real)
    x = np.empty(n_unknowns, dtype=real)
    zero = x.dtype.type(0)
    for g in range(first, last):
        n = count[g]
        width = 16 * ((4 * n + 15) // 16)
        sums[: 4 * n, :width] = 0.0
        held = 0
        for i in range(start[g], start[g + 1]):
            k = n - 1 if free[i] else 0
            for s in range(n_unknowns):
                if coupled:
                    for c in range(3):
                        step[i, s] += inverse[i, s, k + c] * change[i, c]
                x[s] = step[i, s]
            sum_w = zero
            for q in range(k):
                sum_w += x[q]
            c = importance[i]
            z = k
            for e in range(n_points):
                p0, p1, p2, p3 = points[i, e, 0], points[i, e, 1], points[i, e, 2], points[i, e, 3]
                g0 = g1 = g2 = zero
                if e > 0 or move_rest:
                    g0, g1, g2 = c * x[z], c * x[z + 1], c * x[z + 2]
                    z += 3
                for q in range(n):
                    dw = zero
                    if k > 0:
                        s = slot[i, q]
                        dw = -c * sum_w if s == 0 else c * x[s - 1]
                    w, u = weights[i, q], 4 * q
                    v = held
                    a[v, u], a[v, u + 1], a[v, u + 2], a[v, u + 3] = w * p0, w * p1, w * p2, w * p3
                    delta[v, u] = dw * p0 + w * g0
                    delta[v, u + 1] = dw * p1 + w * g1
                    delta[v, u + 2] = dw * p2 + w * g2
                    delta[v, u + 3] = dw * p3
                held += 1
            # four points at a time, since each pass reads and writes all sums
            if held + n_points > 4 or i + 1 == start[g + 1]:
                a[held:] = 0.0
                for u in range(4 * n):
                    v0, v1, v2, w = a[0, u], a[1, u], a[2, u], a[3, u]
                    for t in range(width):
                        sums[u, t] += (
                            v0 * delta[0, t] + v1 * delta[1, t] + v2 * delta[2, t] + w * delta[3, t]
                        )
                held = 0
        for s in range(n):
            for q in range(n):
                m = total[bones[g, s], bones[g, q]]
                for e in range(4):
                    for d in range(4):
                        m[e, d] += sums[4 * s + e, 4 * q + d]


@kernel
def apply_vertex_step(step, rest, normals, indices, weights, length, locked, move_rest):
    """Move weights, rest position and normal by −step; keep weights non-negative with sum 1.

    step          (V, D)      float64  step of all weights except the first, then of the rest
                                       position where `move_rest`, then of the normal as a point, in
    rest          (V, 3)      float64  rest positions, updated where `move_rest`
    normals       (V, P-1, 3) float64  rest normals, updated
    indices       (V, K)      int32    bone of each influence, updated
    weights       (V, K)      float64  its weight, descending, updated
    length        float                length of a normal treated as a point, in
    locked        (V,)        bool     vertices whose weights are not changed, in
    """
    n_keep = indices.shape[1]
    w = np.empty(n_keep)
    ids = np.empty(n_keep, dtype=np.uint32)
    for i in range(len(rest)):
        n = read_influences(indices[i], weights[i], ids, w)
        k = 0 if locked[i] else n - 1
        if k > 0:
            total = 0.0
            for q in range(1, n):
                w[q] = max(w[q] - step[i, q - 1], 0.0)
                total += w[q]
            w[0] = max(1.0 - total, 0.0)
            store(ids, w, n, indices[i], weights[i])
        if move_rest:
            for c in range(3):
                rest[i, c] -= step[i, k + c]
            k += 3
        if length > 0.0:
            for t in range(normals.shape[1]):
                for c in range(3):
                    normals[i, t, c] -= step[i, k + 3 * t + c] / length


@kernel
def tangent_image(transforms, x, scale, out):
    """Compute the first-order change of the transforms under tangents of the bones.

    transforms  (F, B, 3, 4)  float64  bones, in
    x           (F, B, 6)     float64  tangents (ω, τ), in
    scale       (F,)          float64  root of each frame's importance, in
    out         (3F, 4, B)    real     scale times δM, out
    """
    for t in range(len(transforms)):
        s = scale[t]
        for j in range(transforms.shape[1]):
            m = transforms[t, j]
            for c in range(3):
                row = out[3 * t + c]
                shift = 0.0
                for d in range(3):
                    e, f = (d + 1) % 3, (d + 2) % 3
                    row[d, j] = s * (m[c, e] * x[t, j, f] - m[c, f] * x[t, j, e])
                    shift += s * m[c, d] * x[t, j, 3 + d]
                row[3, j] = shift


@kernel
def tangent_pullback(transforms, g, scale, out):
    """Apply the transpose of :func:`tangent_image`.

    transforms  (F, B, 3, 4)  float64  bones, in
    g           (3F, 4, B)    real     gradient with respect to the entries of the transforms, in
    scale       (F,)          float64  root of each frame's importance, in
    out         (F, B, 6)     float64  gradient with respect to the tangents (ω, τ), out
    """
    for t in range(len(transforms)):
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
def move_bones(transforms, x):
    """Replace M by M exp(x), to second order and with exactly orthonormal rotations.

    transforms  (F, B, 3, 4)  float64  bones, updated
    x           (F, B, 6)     float64  tangents (ω, τ), in
    """
    turn, old = np.empty((3, 3)), np.empty(3)
    for t in range(len(transforms)):
        for j in range(transforms.shape[1]):
            m = transforms[t, j]
            for c in range(3):
                for d in range(3):
                    m[c, 3] += m[c, d] * x[t, j, 3 + d]
            turn_bone(m, x[t, j, 0], x[t, j, 1], x[t, j, 2], turn, old)
