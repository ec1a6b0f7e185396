"""Gauss–Newton steps on weights, rest position and normal of many vertices at once.

The unknowns of a vertex are all its weights except the largest, since weights sum to 1, then its
rest position and, if it has one, its normal.  These are at most D = K − 1 + 3P for P points.
"""

from __future__ import annotations

import numpy as np

from .lanes import LANES, add_pull, blend, errors, factor, forms, invert, joint_system, solve
from .policy import inline, kernel
from .simplex_qp import RIDGE
from .vertices import store


@inline
def gather(first, last, y, gram4, indices, weights, locked, ids, w, free, count, along, blocks):
    """Load the influences of vertices first..last, and the sums over frames for their bones.

    Lanes without a vertex repeat the last one.
    """
    n_keep = len(w)
    for lane in range(LANES):
        i = min(first + lane, last - 1)
        n = 0
        for q in range(n_keep):
            if weights[i, q] > 0.0:
                ids[n, lane] = indices[i, q]
                w[n, lane] = weights[i, q]
                n += 1
        count[lane] = n
        for q in range(n_keep):
            if q >= n:
                ids[q, lane] = ids[0, lane]
                w[q, lane] = 0.0
            free[q, lane] = 0.0 if q == 0 or q >= n or locked[i] else 1.0
        pair = 0
        for q in range(n_keep):
            j = ids[q, lane]
            for t in range(y.shape[1]):
                for d in range(4):
                    along[q, t, d, lane] = y[i, t, d, j]
            for s in range(q, n_keep):
                block = gram4[j, ids[s, lane]]
                for d in range(4):
                    for e in range(4):
                        blocks[pair, 4 * d + e, lane] = block[d, e]
                pair += 1


@kernel
def polish_vertices(
    y,
    x2,
    gram4,
    rest,
    indices,
    weights,
    error,
    normals,
    normal_error,
    hold,
    length,
    locked,
    move_rest,
    rounds,
    inverse,
    gradient,
):
    """Move weights and points of each vertex together; no vertex's error rises.

    y             (V, P, 4, B)  float64  Σ_t M_j^tᵀ v_i^t of position and normal, in
    x2            (V, P)        float64  Σ_t |v_i^t|², in
    gram4         (B, B, 4, 4)  float64  G_jk, in
    rest          (V, 3)        float64  rest positions, updated where `move_rest`
    indices       (V, K)        int32    bone of each influence, updated
    weights       (V, K)        float64  its weight, descending, updated
    error         (V,)          float64  squared error of the positions, out
    normals       (V, P-1, 3)   float64  rest normals, updated
    normal_error  (V,)          float64  squared error with respect to the unit normals, out
    hold          (V, 4)        float64  pull (μ, m) on each rest position, in
    length        float                  length of a normal treated as a point, in
    locked        (V,)          bool     vertices whose weights are not changed, in
    inverse       (V, D, D)     float64  inverse of the Gauss–Newton matrix, out
    gradient      (V, D)        float64  half gradient of the error, out

    Each vertex takes up to `rounds` Gauss–Newton steps; a step that does not lower the error is
    not taken.  The Schur complement needs `inverse` and `gradient`.
    """
    n_keep = indices.shape[1]
    n_points = x2.shape[1]
    fixed = 0 if move_rest else 1
    size = n_keep - 1 + 3 * (n_points - fixed)
    ids = np.zeros((n_keep, LANES), dtype=np.uint32)
    count = np.empty(LANES, dtype=np.int64)
    each = n_keep, LANES
    w, trial, free = np.empty(each), np.empty(each), np.empty(each)
    f, slope = np.empty(each), np.empty(each)
    p, moved = np.empty((n_points, 3, LANES)), np.empty((n_points, 3, LANES))
    along = np.empty((n_keep, n_points, 4, LANES))
    blocks = np.empty((n_keep * (n_keep + 1) // 2, 16, LANES))
    turned = np.empty((n_points, n_keep, 3, LANES))
    mean, h = np.empty((3, 3, LANES)), np.empty((n_keep, n_keep, LANES))
    a, x = np.empty((size, size, LANES)), np.empty((size, size, LANES))
    g, b, scale = np.empty((size, LANES)), np.empty((size, LANES)), np.empty((size, LANES))
    pull, squares = np.empty((4, LANES)), np.empty((n_points + 1, LANES))
    e, e_new, step, total = np.empty(LANES), np.empty(LANES), np.empty(LANES), np.empty(LANES)
    live, pending, bad, take = np.empty(LANES), np.empty(LANES), np.empty(LANES), np.empty(LANES)
    own, own_w = np.empty(n_keep, dtype=np.uint32), np.empty(n_keep)
    place = np.empty(size, dtype=np.int64)
    for first in range(0, len(rest), LANES):
        last = min(first + LANES, len(rest))
        for lane in range(LANES):
            i = min(first + lane, last - 1)
            squares[n_points, lane] = 0.0
            for c in range(3):
                p[0, c, lane] = rest[i, c]
            for t in range(n_points):
                squares[t, lane] = x2[i, t]
                squares[n_points, lane] += x2[i, t]
                for c in range(3 if t > 0 else 0):
                    p[t, c, lane] = length * normals[i, t - 1, c]
            for d in range(4):
                pull[d, lane] = hold[i, d]
            live[lane] = 1.0
        moving = 1.0
        for turn in range(rounds + 1):
            final = turn == rounds or moving == 0.0
            if final and rounds > 0:
                for i in range(first, last):
                    n = count[i - first]
                    if not locked[i]:
                        for q in range(n):
                            own[q], own_w[q] = ids[q, i - first], w[q, i - first]
                        store(own, own_w, n, indices[i], weights[i])
            if final or turn == 0:
                gather(
                    first, last, y, gram4, indices, weights, locked,
                    ids, w, free, count, along, blocks,
                )  # fmt: skip
            # at the end also the error of each point alone
            for t in range(0 if final else n_points, n_points + 1):
                alone = t < n_points
                forms(blocks, along, p, t if alone else 0, t + 1 if alone else n_points, h, f)
                errors(h, f, w, squares[t], e)
                for i in range(first, last if alone else first):
                    if t == 0:
                        error[i] = max(e[i - first], 0.0)
                    elif length > 0.0:
                        normal_error[i] = max(e[i - first], 0.0) / (length * length)
            add_pull(pull, p, e)
            blend(blocks, w, p, turned, mean)
            joint_system(along, pull, w, free, p, fixed, h, f, turned, mean, slope, a, g)
            factor(a, size, 1e-9 if final else RIDGE, 1e-12 if final else 0.0, scale, bad)
            if final:
                break
            for q in range(size):
                out, u, v = b[q], g[q], scale[q]
                for k in range(LANES):
                    out[k] = -u[k] * v[k]
            solve(a, b, size)
            for q in range(size):
                out, u = b[q], scale[q]
                for k in range(LANES):
                    out[k] *= u[k]
            # the longest step that keeps all weights at 0 or above
            step[:] = 1.0
            total[:] = 0.0
            for q in range(1, n_keep):
                u, v = b[q - 1], w[q]
                for k in range(LANES):
                    total[k] += u[k]
                    step[k] = -v[k] / u[k] if v[k] + step[k] * u[k] < 0.0 else step[k]
            for k in range(LANES):
                if w[0, k] - step[k] * total[k] < 0.0:
                    step[k] = w[0, k] / total[k]
                if bad[k] > 0.0:
                    live[k] = 0.0
                pending[k] = live[k]
            for _ in range(3):
                for q in range(n_keep):
                    out, u, v = trial[q], total if q == 0 else b[q - 1], w[q]
                    sign = -1.0 if q == 0 else 1.0
                    for k in range(LANES):
                        out[k] = max(v[k] + sign * step[k] * u[k], 0.0)
                for t in range(n_points):
                    z = n_keep - 1 + 3 * (t - fixed)
                    for c in range(3):
                        out, u = moved[t, c], p[t, c]
                        if t < fixed:
                            out[:] = u
                            continue
                        v = b[z + c]
                        for k in range(LANES):
                            out[k] = u[k] + step[k] * v[k]
                forms(blocks, along, moved, 0, n_points, h, f)
                errors(h, f, trial, squares[n_points], e_new)
                add_pull(pull, moved, e_new)
                left = 0.0
                for k in range(LANES):
                    take[k] = 1.0 if pending[k] > 0.0 and e_new[k] < e[k] else 0.0
                    if take[k] > 0.0:
                        pending[k] = 0.0
                        live[k] = 0.0 if e[k] - e_new[k] < 1e-5 * e[k] else 1.0
                        e[k] = e_new[k]
                    step[k] *= 0.3
                    left += pending[k]
                for q in range(n_keep):
                    out, u = w[q], trial[q]
                    for k in range(LANES):
                        out[k] = u[k] if take[k] > 0.0 else out[k]
                for t in range(n_points):
                    for c in range(3):
                        out, u = p[t, c], moved[t, c]
                        for k in range(LANES):
                            out[k] = u[k] if take[k] > 0.0 else out[k]
                if left == 0.0:
                    break
            moving = 0.0
            for k in range(LANES):
                if pending[k] > 0.0:
                    live[k] = 0.0
                moving += live[k]
        invert(a, size, x)
        for lane in range(last - first):
            i = first + lane
            for c in range(3):
                rest[i, c] = p[0, c, lane]
            if length > 0.0:
                for t in range(1, n_points):
                    for c in range(3):
                        normals[i, t - 1, c] = p[t, c, lane] / length
            n = 0 if locked[i] else count[lane] - 1
            for q in range(size):
                place[q] = q if q < n else -1
                if q >= n_keep - 1:
                    place[q] = q - (n_keep - 1) + n
            gradient[i] = 0.0
            inverse[i] = 0.0
            for q in range(size):
                if place[q] < 0:
                    continue
                gradient[i, place[q]] = g[q, lane]
                for s in range(q + 1):
                    if place[s] >= 0:
                        value = a[q, s, lane] * scale[q, lane] * scale[s, lane]
                        inverse[i, place[q], place[s]] = value
                        inverse[i, place[s], place[q]] = value
