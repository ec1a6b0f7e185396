"""The vertex step of the polish, the Gauss–Newton iteration that eliminates the vertices.

The unknowns of a vertex are all its weights except the largest, since weights sum to 1, then its
rest position and, if it has one, its normal.  These are at most D = K − 1 + 3P for P points.
"""

from __future__ import annotations

import numpy as np

from .policy import inline, kernel
from .simplex_qp import cheapest_to_drop, cholesky_solve, equilibrate, invert, simplex_qp
from .vertices import (
    load_points,
    pull_error,
    read_influences,
    store,
    store_points,
    vertex_error,
)
from .weights import (
    all_pulled,
    begin_qp,
    close_gaps,
    gradient_of_all,
    hessian_row,
    pulled,
    take_columns,
)


@inline
def joint_system(gram4, y, pull, ids, w, n, p, with_weights, with_rest, h, moved, turned, a, g):
    """Write the Gauss–Newton matrix a and half gradient g of one vertex's error; return their size.

    Also written are, for influences q and s, h (n, n) = Σ p̃ᵀ G_qs p̃ over the points p̃, and for
    each point moved (n, 4) = Σ_s w_s G_qs p̃ and turned (n, 4) = Σ_s w_s G_sq p̃.
    """
    k = n - 1 if with_weights else 0
    a00 = a10 = a11 = a20 = a21 = a22 = 0.0
    for t in range(p.shape[0]):
        p0, p1, p2, p3 = p[t, 0], p[t, 1], p[t, 2], p[t, 3]
        for q in range(n):
            for d in range(4):
                moved[t, q, d] = 0.0
                turned[t, q, d] = 0.0
        for q in range(n):
            wq = w[q]
            for s in range(n):
                # G_sq is the transpose of G_qs: its rows lie as vectors of four in memory
                m = gram4[ids[s], ids[q]]
                ws = w[s]
                t0 = m[0, 0] * p0 + m[1, 0] * p1 + m[2, 0] * p2 + m[3, 0] * p3
                t1 = m[0, 1] * p0 + m[1, 1] * p1 + m[2, 1] * p2 + m[3, 1] * p3
                t2 = m[0, 2] * p0 + m[1, 2] * p1 + m[2, 2] * p2 + m[3, 2] * p3
                t3 = m[0, 3] * p0 + m[1, 3] * p1 + m[2, 3] * p2 + m[3, 3] * p3
                along = t0 * p0 + t1 * p1 + t2 * p2 + t3 * p3
                moved[t, q, 0] += ws * t0
                moved[t, q, 1] += ws * t1
                moved[t, q, 2] += ws * t2
                moved[t, q, 3] += ws * t3
                turned[t, s, 0] += wq * t0
                turned[t, s, 1] += wq * t1
                turned[t, s, 2] += wq * t2
                turned[t, s, 3] += wq * t3
                if t > 0:
                    h[q, s] += along
                    continue
                h[q, s] = along
                ws *= wq
                a00 += ws * m[0, 0]
                a10 += ws * m[1, 0]
                a11 += ws * m[1, 1]
                a20 += ws * m[2, 0]
                a21 += ws * m[2, 1]
                a22 += ws * m[2, 2]
    g0 = along_points(moved, 0, p) - pulled(y, ids[0], p)
    for q in range(1, k + 1):
        g[q - 1] = along_points(moved, q, p) - pulled(y, ids[q], p) - g0
        for s in range(1, q + 1):
            a[q - 1, s - 1] = h[q, s] - h[0, s] - h[q, 0] + h[0, 0]
    z = k
    for t in range(0 if with_rest else 1, p.shape[0]):
        mu = pull[0] if t == 0 else 0.0
        for c in range(3):
            value = mu * (p[t, c] - pull[1 + c])
            for q in range(n):
                value += w[q] * (moved[t, q, c] - y[t, c, ids[q]])
            g[z + c] = value
            for q in range(1, k + 1):
                a[z + c, q - 1] = turned[t, q, c] - turned[t, 0, c]
            for q in range(k, z):
                a[z + c, q] = 0.0
        a[z, z] = a00 + mu
        a[z + 1, z], a[z + 1, z + 1] = a10, a11 + mu
        a[z + 2, z], a[z + 2, z + 1], a[z + 2, z + 2] = a20, a21, a22 + mu
        z += 3
    return z


@inline
def along_points(moved, q, p):
    """Sum Σ p̃ᵀ moved_q over the points p̃ of a vertex."""
    value = 0.0
    for t in range(p.shape[0]):
        for d in range(4):
            value += moved[t, q, d] * p[t, d]
    return value


@inline
def error_at(x2, y, ids, w, n, p, moved):
    """Squared error of one point p (4,), given `moved` from :func:`joint_system` for the same w."""
    e = x2
    for q in range(n):
        value = 0.0
        for d in range(4):
            value += (moved[q, d] - 2.0 * y[d, ids[q]]) * p[d]
        e += w[q] * value
    return e


@kernel
def polish_vertices(
    y,
    x2,
    gram,
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
    entering,
    rounds,
    inverse,
    gradient,
):
    """Improve the weights and rest position of each vertex; no vertex's error rises.

    y             (V, P, 4, B)  float64  Σ_t M_j^tᵀ v_i^t of position and normal, in
    x2            (V, P)        float64  Σ_t |v_i^t|², in
    gram          (B, 10, B)    float64  coefficients of p̃ᵀ G_jk p̃, in
    gram4         (B, B, 4, 4)  float64  G_jk, in
    rest          (V, 3)        float64  rest positions, updated where `move_rest`
    indices       (V, K)        int32    bone of each influence, updated
    weights       (V, K)        float64  its weight, descending, updated
    error         (V,)          float64  squared error of the positions, out
    normals       (V, P-1, 3)   float64  rest normals, updated
    normal_error  (V,)          float64  squared error of the normals, as of unit vectors, out
    hold          (V, 4)        float64  pull (μ, m) on each rest position, in
    length        float                  that of a normal as a point
    locked        (V,)          bool     vertices whose weights are not changed, in
    inverse       (V, D, D)     float64  inverse of the Gauss–Newton matrix, out
    gradient      (V, D)        float64  half gradient of the error, out

    First the weights are solved, unless `entering` is negative.  Then up to `entering` bones, those
    of smallest gradient, are tried.  Such a bone joins the vertex's influences, or replaces one if
    there are K already, provided that this lowers the error.  At last, up to `rounds` Gauss–Newton
    steps move weights and rest position together; a step that does not lower the error is not
    taken.  The Schur complement needs `inverse` and `gradient`.
    """
    n_bones = gram.shape[0]
    n_keep = indices.shape[1]
    slots = n_keep + 1
    n_points = x2.shape[1]
    size_max = inverse.shape[1]
    m = np.empty(10)
    rows = np.empty((slots, n_bones))
    h = np.empty((slots, slots))
    f = np.empty(slots)
    f_all = np.empty(n_bones)
    grad = np.empty(n_bones)
    barred = np.empty(n_bones, dtype=np.bool_)
    w = np.empty(slots)
    trial = np.empty(slots)
    best_w = np.empty(slots)
    ids = np.empty(slots, dtype=np.uint32)
    alive = np.empty(slots, dtype=np.uint32)
    a = np.empty((size_max + 1, size_max + 1))
    b = np.empty(size_max + 1)
    g = np.empty(size_max + 1)
    scale = np.empty(size_max + 1)
    moved = np.empty((n_points, slots, 4))
    turned = np.empty((n_points, slots, 4))
    p = np.empty((n_points, 4))
    p_new = np.empty((n_points, 4))
    full = np.empty((size_max, 16 * ((size_max + 15) // 16)))
    row = np.empty(full.shape[1])
    for i in range(len(rest)):
        load_points(rest[i], normals[i], length, p)
        whole = x2[i].sum()
        n = read_influences(indices[i], weights[i], ids, w)
        with_weights = not locked[i]
        if with_weights and entering >= 0:
            begin_qp(y[i], gram, ids, n, p, m, rows, h, f, alive)
            simplex_qp(h, f, w, alive, n, a, b)
            if entering > 0:
                all_pulled(y[i], p, f_all)
                barred[:] = False
            for _ in range(entering):
                # drop bones of weight zero
                n = close_gaps(ids, w, f, rows, n)
                gradient_of_all(f_all, rows, w, n, grad)
                level = 0.0
                base = 0.0
                for q in range(n):
                    level += w[q] * grad[ids[q]]
                    base += w[q] * (grad[ids[q]] - f[q])
                enter = -1
                for j in range(n_bones):
                    if not barred[j] and (enter < 0 or grad[j] < grad[enter]):
                        known = False
                        for q in range(n):
                            if ids[q] == j:
                                known = True
                        if not known:
                            enter = j
                if enter < 0 or not level - grad[enter] > 1e-12 * whole:
                    break
                barred[enter] = True
                hessian_row(gram, enter, m, rows[n])
                ids[n] = enter
                f[n] = f_all[enter]
                take_columns(rows, ids, n + 1, h, alive)
                best = base
                found = False
                first_out = second_out = -1
                for attempt in range(3):
                    out = -1
                    if attempt == 1:
                        out = first_out
                    elif attempt == 2:
                        out = second_out
                    if attempt > 0 and out < 0:
                        break
                    # first try all bones: if at most K weights stay positive, none has to be
                    # dropped
                    left = 0
                    total = 0.0
                    for q in range(n + 1):
                        trial[q] = 0.0
                        if q != out:
                            alive[left] = q
                            left += 1
                            trial[q] = w[q] if q < n else 0.0
                            total += trial[q]
                    if total > 1e-9:
                        for q in range(n + 1):
                            trial[q] /= total
                    else:
                        trial[n] = 1.0
                    simplex_qp(h, f, trial, alive, left, a, b)
                    positive = 0
                    value = 0.0
                    for q in range(n + 1):
                        if trial[q] > 0.0:
                            positive += 1
                            value -= 2.0 * trial[q] * f[q]
                            for s in range(n + 1):
                                value += trial[q] * trial[s] * h[q, s]
                    if positive <= n_keep and value < best - 1e-14 * whole:
                        best = value
                        found = True
                        for q in range(n + 1):
                            best_w[q] = trial[q]
                    if attempt == 0:
                        if positive <= n_keep:
                            break
                        first_out, second_out, rise = cheapest_to_drop(
                            h, trial, n + 1, a, full, row, scale
                        )
                        if not value + rise < best:
                            break
                if found:
                    n += 1
                    for q in range(n):
                        w[q] = best_w[q]
                else:
                    w[n] = 0.0
            # the largest weight comes first: it is the one that follows from the others
            store(ids, w, n, indices[i], weights[i])
            n = read_influences(indices[i], weights[i], ids, w)
        e = 0.0
        for turn in range(rounds):
            size = joint_system(
                gram4, y[i], hold[i], ids, w, n, p, with_weights, move_rest, h, moved, turned, a, g
            )
            if size == 0:
                break
            if turn == 0:
                e = pull_error(hold[i], p)
                for t in range(n_points):
                    e += error_at(x2[i, t], y[i, t], ids, w, n, p[t], moved[t])
            equilibrate(a, size, scale)
            for q in range(size):
                b[q] = -g[q] * scale[q]
            if not cholesky_solve(a, b, size):
                break
            k = n - 1 if with_weights else 0
            step = 1.0
            total = 0.0
            for q in range(k):
                d = b[q] * scale[q]
                total += d
                if w[q + 1] + step * d < 0.0:
                    step = -w[q + 1] / d
            if w[0] - step * total < 0.0:
                step = w[0] / total
            better = False
            for _ in range(3):
                for q in range(k):
                    trial[q + 1] = max(w[q + 1] + step * b[q] * scale[q], 0.0)
                trial[0] = max(w[0] - step * total, 0.0) if k > 0 else w[0]
                if k == 0:
                    for q in range(n):
                        trial[q] = w[q]
                z = k
                for t in range(n_points):
                    for c in range(4):
                        p_new[t, c] = p[t, c]
                    if t > 0 or move_rest:
                        for c in range(3):
                            p_new[t, c] += step * b[z + c] * scale[z + c]
                        z += 3
                e_new = vertex_error(x2[i], gram4, y[i], hold[i], ids, trial, n, p_new)
                if e_new < e:
                    better = True
                    break
                step *= 0.3
            if not better:
                break
            small = e - e_new < 1e-5 * e
            e = e_new
            for q in range(n):
                w[q] = trial[q]
            p[:] = p_new
            if small:
                break
        if with_weights and rounds > 0:
            store(ids, w, n, indices[i], weights[i])
            n = read_influences(indices[i], weights[i], ids, w)
        size = joint_system(
            gram4, y[i], hold[i], ids, w, n, p, with_weights, move_rest, h, moved, turned, a, g
        )
        error[i] = max(error_at(x2[i, 0], y[i, 0], ids, w, n, p[0], moved[0]), 0.0)
        if n_points > 1 and length > 0.0:
            more = error_at(x2[i, 1], y[i, 1], ids, w, n, p[1], moved[1])
            normal_error[i] = max(more, 0.0) / (length * length)
        store_points(p, length, rest[i], normals[i])
        for q in range(size_max):
            gradient[i, q] = g[q] if q < size else 0.0
            for s in range(size_max):
                inverse[i, q, s] = 0.0
        equilibrate(a, size, scale)
        invert(a, size, full, row)
        for q in range(size):
            for s in range(q + 1):
                value = scale[q] * scale[s] * full[q, s]
                inverse[i, q, s] = value
                inverse[i, s, q] = value
