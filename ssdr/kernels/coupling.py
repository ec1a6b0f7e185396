"""The edges between rest positions in the polish: a solve of all rest positions together."""

from __future__ import annotations

import numpy as np

from .policy import kernel

BLOCK = 64  # vertices at once: their rows stay in the cache between loops


@kernel
def begin_coupling(inverse, column, importance, hold, diagonal, response, matrix, inverted):
    """Compute what a solve of the rest positions needs of each vertex.

    inverse     (V, D, D)  float64  inverse of the Gauss–Newton matrix with the pull, in
    column      (V,)       integer  first of the rest position's three columns in it, in
    importance  (V,)       float64  factor of each vertex's error, in
    hold        (V,)       float64  stiffness of the pull, before importance multiplies it, in
    diagonal    (V,)       float64  what takes its place: λ times the sum of the edges' weights, in
    response    (3, 3, V)  real     matrix of the rest position with the other unknowns eliminated,
                                    out
    matrix      (3, 3, V)  real     the same without the pull, times importance, + `diagonal`, out
    inverted    (3, 3, V)  real     its inverse, out
    """
    a, b = np.empty((3, 3)), np.empty((3, 3))
    for i in range(len(column)):
        p = column[i]
        for turn in range(2):
            for c in range(3):
                for d in range(3):
                    if turn == 0:
                        a[c, d] = 0.5 * (inverse[i, p + c, p + d] + inverse[i, p + d, p + c])
                    else:
                        a[c, d] = importance[i] * b[c, d]
                        if c == d:
                            a[c, d] += diagonal[i] - importance[i] * hold[i]
                        response[c, d, i] = b[c, d]
                        matrix[c, d, i] = a[c, d]
            # by cofactors
            for c in range(3):
                e, f = (c + 1) % 3, (c + 2) % 3
                for d in range(3):
                    g, h = (d + 1) % 3, (d + 2) % 3
                    b[d, c] = a[e, g] * a[f, h] - a[e, h] * a[f, g]
            whole = a[0, 0] * b[0, 0] + a[0, 1] * b[1, 0] + a[0, 2] * b[2, 0]
            whole = 1.0 / whole if whole > 0.0 else 0.0
            for c in range(3):
                for d in range(3):
                    b[c, d] *= whole
        inverted[:, :, i] = b


@kernel
def couple_vertices(
    step,
    moves,
    group,
    bones,
    count,
    points,
    weights,
    order,
    column,
    response,
    matrix,
    inverted,
    shift,
    start,
    ends,
    edges,
    limit,
    least,
    change,
):
    """Solve rest positions with the edges between them, given the answer without edges.

    step      (V, D)     real     answer of each vertex under its pull, in the order of groups, in
    moves     (B, 3, 4)  real     change of each bone's transform, M times this, that is the same in
                                  all frames; rest positions that follow it are the first guess, in
    group, bones, count, points, weights    as in :func:`answer_bones`, in
    order     (V,)       integer  vertex of each row of `step`, in
    column    (V,)       integer  first column of the rest position, by vertex, in
    response, matrix, inverted    as :func:`begin_coupling` returns them, by vertex, in
    shift     (V,)       real     stiffness of the pull less the `diagonal` of `matrix`, in
    start     (V + 1,)   integer  start[i]..start[i + 1]: edges of vertex i, in
    ends      (E,)       integer  the other end of each edge, in
    edges     (E,)       real     λ times the weights of the edges, in
    limit     integer             most iterations, in
    least     float               relative norm of the residual that ends them, in
    change    (V, 3)     real     by which the right side of each rest position moves, so that the
                                  answer without edges becomes the one with them, out

    Conjugate gradients, preconditioned by the blocks of the vertices.
    """
    n = len(order)
    real = edges.dtype
    x = np.zeros((3, n), dtype=real)
    r = np.zeros((3, n), dtype=real)
    d = np.zeros((3, n), dtype=real)
    q = np.empty((3, n), dtype=real)
    each = np.empty(BLOCK)
    for g in range(len(count)):
        for k in range(group[g], group[g + 1]):
            i = order[k]
            for c in range(3):
                value = real.type(0)
                for s in range(count[g]):
                    m = moves[bones[g, s], c]
                    p = points[k, 0]
                    value += weights[k, s] * (m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3] * p[3])
                d[c, i] = value
                x[c, i] = value - step[k, column[i] + c]
    rho = beginning = 0.0
    for turn in range(limit + 1):
        # turn 0: q = −residual of the guess; then: q = matrix d − edges d
        x0, x1, x2 = d[0], d[1], d[2]
        each[:] = 0.0
        for i0 in range(0, n, BLOCK):
            width = min(BLOCK, n - i0)
            i1 = i0 + width
            q0, q1, q2 = q[0, i0:i1], q[1, i0:i1], q[2, i0:i1]
            bounds = start[i0 : i1 + 1]
            for k in range(width):
                s0 = s1 = s2 = real.type(0)
                for e in range(bounds[k], bounds[k + 1]):
                    j, w = ends[e], edges[e]
                    s0 += w * x0[j]
                    s1 += w * x1[j]
                    s2 += w * x2[j]
                q0[k], q1[k], q2[k] = s0, s1, s2
            of = x if turn == 0 else d
            u0, u1, u2 = of[0, i0:i1], of[1, i0:i1], of[2, i0:i1]
            for c in range(3):
                out, u = q[c, i0:i1], d[c, i0:i1]
                v0, v1, v2 = matrix[c, 0, i0:i1], matrix[c, 1, i0:i1], matrix[c, 2, i0:i1]
                for k in range(width):
                    out[k] = v0[k] * u0[k] + v1[k] * u1[k] + v2[k] * u2[k] - out[k]
                if turn == 0:
                    v0, v1 = shift[i0:i1], x[c, i0:i1]
                    for k in range(width):
                        out[k] += v0[k] * (v1[k] - u[k])
                else:
                    for k in range(width):
                        each[k] += out[k] * u[k]
        alpha = 0.0
        if turn > 0:
            curvature = each.sum()
            if not curvature > 0.0:
                break
            alpha = rho / curvature
        along = real.type(alpha)
        each[:] = 0.0
        for i0 in range(0, n, BLOCK):
            width = min(BLOCK, n - i0)
            i1 = i0 + width
            for c in range(3):
                out, u = r[c, i0:i1], q[c, i0:i1]
                if turn == 0:
                    out[:] = -u
                for k in range(width):
                    out[k] -= along * u[k]
                out, u = x[c, i0:i1], d[c, i0:i1]
                for k in range(width):
                    out[k] += along * u[k]
            u0, u1, u2 = r[0, i0:i1], r[1, i0:i1], r[2, i0:i1]
            for c in range(3):
                out, u = q[c, i0:i1], r[c, i0:i1]
                v0, v1, v2 = inverted[c, 0, i0:i1], inverted[c, 1, i0:i1], inverted[c, 2, i0:i1]
                for k in range(width):
                    out[k] = v0[k] * u0[k] + v1[k] * u1[k] + v2[k] * u2[k]
                for k in range(width):
                    each[k] += out[k] * u[k]
        old, rho = rho, each.sum()
        if turn == 0:
            beginning = old = rho
        if turn == limit or not rho > least * least * beginning:
            break
        beta = real.type(rho / old)
        if turn == 0:
            beta = real.type(0)
        for c in range(3):
            out, u = d[c], q[c]
            for k in range(n):
                out[k] = u[k] + beta * out[k]
    for k in range(n):
        i = order[k]
        for c in range(3):
            value = real.type(0)
            for e in range(3):
                value += response[c, e, i] * x[e, i]
            change[k, c] = value


@kernel
def add_patches(
    points, indices, weights, importance, turns, diagonal, start, ends, edges, first, last, total
):
    """Add up the cost of one change of a bone in all frames, if the rest pose follows the bones.

    points      (V, P, 4)     float64  points p̃ of each vertex, in
    indices     (V, K)        int32    bone of each influence, in
    weights     (V, K)        float64  its weight, in
    importance  (V,)          float64  factor of each vertex's error, in
    turns       (B, B)        float64  Σ_t s² tr(R_jᵀ R_k)/3, in
    diagonal    (V,)          float64  λ times the sum of the edges' weights, in
    start, ends, edges                 as in :func:`couple_vertices`, in
    total       (B, B, 4, 4)  float64  half of Σ_i x_iᵀ T x_i, for x_i the changes of the bones'
                                       transforms in the rest pose, without the sum of w_j w_k p̃ p̃ᵀ
                                       turns[j, k], added to for the vertices first..last
    """
    n_keep = indices.shape[1]
    around = np.zeros((len(turns), 4))
    met = np.empty(len(turns), dtype=np.int64)
    known = np.zeros(len(turns), dtype=np.bool_)
    own = np.empty(n_keep)
    for i in range(first, last):
        mean = 0.0
        for k in range(n_keep):
            own[k] = 0.0
            for q in range(n_keep):
                own[k] += weights[i, q] * turns[indices[i, q], indices[i, k]]
            mean += weights[i, k] * own[k]
        for k in range(n_keep):
            own[k] = importance[i] * (0.5 * mean - own[k]) * weights[i, k]
        count = 0
        for e in range(start[i] - 1, start[i + 1]):
            j, share = i, 0.5 * diagonal[i]
            if e >= start[i]:
                j, share = ends[e], -0.5 * edges[e]
            for k in range(n_keep):
                w, b = share * weights[j, k], indices[j, k]
                if j == i:
                    w += own[k]
                if weights[j, k] > 0.0:
                    if not known[b]:
                        known[b] = True
                        met[count] = b
                        count += 1
                    for d in range(4):
                        around[b, d] += w * points[j, 0, d]
        for k in range(n_keep):
            if not weights[i, k] > 0.0:
                continue
            row = total[indices[i, k]]
            for q in range(count):
                for d in range(4):
                    for e in range(4):
                        row[met[q], d, e] += weights[i, k] * points[i, 0, d] * around[met[q], e]
            for t in range(1, points.shape[1]):
                for q in range(n_keep):
                    for d in range(3):
                        for e in range(3):
                            row[indices[i, q], d, e] += (
                                weights[i, k] * points[i, t, d] * own[q] * points[i, t, e]
                            )
        for q in range(count):
            known[met[q]] = False
            around[met[q]] = 0.0
