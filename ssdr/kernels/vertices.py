"""The vertex step: sparse convex weights and rest position of one vertex at a time.

Symbols are those of :mod:`.weights`; that module sets up the problem in the weights.
"""

from __future__ import annotations

import numpy as np

from .policy import inline, kernel
from .simplex_qp import cholesky_solve, simplex_qp
from .weights import all_pulled, begin_qp, close_gaps, gradient_of_all, hessian_row, take_columns


@inline
def holds(ids, n, bone):
    """Whether `bone` is among the first n bones of `ids`."""
    found = False
    for q in range(n):
        found = found or ids[q] == bone
    return found


@inline
def load_points(rest, normals, length, p):
    """Set the points p (P, 4) of a vertex: (rest position, 1), then (length · normal, 0)."""
    for c in range(3):
        p[0, c] = rest[c]
    p[0, 3] = 1.0
    for t in range(1, p.shape[0]):
        for c in range(3):
            p[t, c] = length * normals[t - 1, c]
        p[t, 3] = 0.0


@inline
def store_points(p, length, rest, normals):
    """Write the rest position and the normal of a vertex back from its points p (P, 4)."""
    for c in range(3):
        rest[c] = p[0, c]
    if length > 0.0:
        for t in range(1, p.shape[0]):
            for c in range(3):
                normals[t - 1, c] = p[t, c] / length


@inline
def form_of(pairs, indices, w, n, form):
    """Set `form` to the ten coefficients of Σ_jk w_j w_k p̃ᵀ G_jk p̃.

    ``pairs[j, k]`` are the ten coefficients of p̃ᵀ G_jk p̃.
    """
    for d in range(10):
        form[d] = 0.0
    for q in range(n):
        for s in range(q + 1):
            c = w[q] * w[s]
            if s < q:
                c *= 2.0
            for d in range(10):
                form[d] += c * pairs[indices[q], indices[s], d]


@inline
def best_point(form, last, g, pull, p, a, b):
    """Move p to the minimiser of form(p̃) − 2 p̃ᵀg + μ|p − m|².

    `form` holds the ten coefficients of :func:`form_of`, p̃ is (p, last), g is Σ_j w_j y_j, and
    `pull` is (μ, m).  The last term counts only if `last` is 1.  p stays if the system is singular.
    """
    x, y, z, mu = p[0], p[1], p[2], last * pull[0]
    a[0, 0], a[1, 1], a[2, 2] = form[0] + mu, form[1] + mu, form[2] + mu
    a[1, 0], a[2, 0], a[2, 1] = 0.5 * form[3], 0.5 * form[4], 0.5 * form[5]
    half = 0.5 * last
    b[0] = g[0] + mu * pull[1] - (a[0, 0] * x + a[1, 0] * y + a[2, 0] * z + half * form[6])
    b[1] = g[1] + mu * pull[2] - (a[1, 0] * x + a[1, 1] * y + a[2, 1] * z + half * form[7])
    b[2] = g[2] + mu * pull[3] - (a[2, 0] * x + a[2, 1] * y + a[2, 2] * z + half * form[8])
    if cholesky_solve(a, b, 3):
        for c in range(3):
            p[c] += b[c]


@inline
def place(y, pairs, pull, ids, w, n, move_rest, p, form, g, a, b):
    """Move the points p to their best places under the weights, the first only if `move_rest`.

    `form` is set to the coefficients of :func:`form_of`.
    """
    form_of(pairs, ids, w, n, form)
    for t in range(p.shape[0]):
        for c in range(4):
            value = 0.0
            for q in range(n):
                value += w[q] * y[t, c, ids[q]]
            g[c] = value
        if t > 0 or move_rest:
            best_point(form, p[t, 3], g, pull, p[t], a, b)


@inline
def point_error(x2, y, form, ids, w, n, p):
    """Squared error of one point p (4,) under given weights.

    `form` (10,) holds the coefficients of the error's quadratic form in p, see :func:`form_of`.
    """
    e = x2
    for c in range(4):
        for q in range(n):
            e -= 2.0 * w[q] * y[c, ids[q]] * p[c]
    x, y_, z, last = p[0], p[1], p[2], p[3]
    e += form[0] * x * x + form[1] * y_ * y_ + form[2] * z * z
    e += form[3] * x * y_ + form[4] * x * z + form[5] * y_ * z
    return e + last * (form[6] * x + form[7] * y_ + form[8] * z + form[9] * last)


@kernel
def solve_vertices(
    y,
    x2,
    gram,
    pairs,
    pull,
    stiff,
    rest,
    support,
    share,
    count,
    indices,
    weights,
    error,
    normals,
    normal_error,
    hold,
    length,
    locked,
    move_rest,
):
    """Take the vertex step of one alternation: solve weights, then rest position, of each vertex.

    y             (V, P, 4, B) float64  Σ_t M_j^tᵀ v_i^t of position and normal, in
    x2            (V, P)       float64  Σ_t |v_i^t|², in
    gram          (B, 10, B)   float64  coefficients of p̃ᵀ G_jk p̃, bones outermost, in
    pairs         (B, B, 10)   float64  the coefficients in `gram`, innermost here, in
    pull          (V, B)       float64  linear term of weight smoothness, empty without it, in
    stiff         (V,)         float64  quadratic term of weight smoothness, empty without it, in
    rest          (V, 3)       float64  rest positions, updated where `move_rest`
    support       (V, S)       int32    bones of the solution before the reduction to K, updated
    share         (V, S)       float64  weights of the bones in `support`, updated
    count         (V,)         int32    number of used slots of `support`, updated
    indices       (V, K)       int32    bones of the K largest weights, updated
    weights       (V, K)       float64  weights of these bones, solved again, descending, updated
    error         (V,)         float64  squared error of the positions, out
    normals       (V, P-1, 3)  float64  rest normals, updated
    normal_error  (V,)         float64  squared error with respect to the unit normals, out
    hold          (V, 4)       float64  pull (μ, m) on each rest position, in
    length        float                 length of a normal treated as a point, in
    locked        (V,)         bool     vertices whose weights are not changed, in

    The weights over all bones start from the support of the previous call.  Bones enter the support
    one by one, each time the bone of smallest gradient.  Smoothness adds stiff·|w|² − 2·pullᵀw to
    the squared error.
    """
    n_bones = gram.shape[0]
    n_slots = support.shape[1]
    n_keep = indices.shape[1]
    m, form, g, p = np.empty(10), np.empty(10), np.empty(4), np.empty((x2.shape[1], 4))
    f_all, grad = np.empty(n_bones), np.empty(n_bones)
    rows, h = np.empty((n_slots, n_bones)), np.empty((n_slots, n_slots))
    f, w = np.empty(n_slots), np.empty(n_slots)
    ids, alive = np.empty(n_slots, dtype=np.uint32), np.empty(n_slots, dtype=np.uint32)
    size = max(n_slots, 3)
    a, b = np.empty((size, size)), np.empty(size)
    smooth = pull.shape[0] > 0
    for i in range(len(rest)):
        load_points(rest[i], normals[i], length, p)
        if locked[i]:
            n = read_influences(indices[i], weights[i], ids, w)
        else:
            n = count[i]
            for q in range(n):
                ids[q] = support[i, q]
                w[q] = share[i, q]
            begin_qp(y[i], gram, ids, n, p, m, rows, h, f, alive)
            all_pulled(y[i], p, f_all)
            alpha = 0.0
            if smooth:
                alpha = stiff[i]
                for j in range(n_bones):
                    f_all[j] += pull[i, j]
                for q in range(n):
                    rows[q, ids[q]] += alpha
                    h[q, q] += alpha
                    f[q] = f_all[ids[q]]
            for _ in range(3 * n_slots):
                left = simplex_qp(h, f, w, alive, n, a, b)
                # drop bones of weight zero
                n = close_gaps(ids, w, f, rows, n)
                take_columns(rows, ids, n, h, alive)
                if n >= n_slots or left == 0:
                    break
                gradient_of_all(f_all, rows, w, n, grad)
                level = 0.0
                for q in range(n):
                    level += w[q] * grad[ids[q]]
                enter = 0
                for j in range(1, n_bones):
                    if grad[j] < grad[enter]:
                        enter = j
                slope = level - grad[enter]
                if not slope > 0.0 or holds(ids, n, enter):
                    break
                hessian_row(gram, enter, m, rows[n])
                rows[n, enter] += alpha
                curve = rows[n, enter]
                e = whole = x2[i].sum()
                for q in range(n):
                    curve -= 2.0 * w[q] * rows[n, ids[q]]
                    e -= w[q] * f[q]
                    for s in range(n):
                        curve += w[q] * w[s] * h[q, s]
                e += level
                # stop if the bone would gain less than a millionth of this vertex's error
                if slope * slope < (1e-6 * max(e, 0.0) + 1e-15 * whole) * max(curve, 1e-300):
                    break
                ids[n] = enter
                w[n] = 0.0
                f[n] = f_all[enter]
                n += 1
                for q in range(n):
                    alive[q] = q
                    h[q, n - 1] = rows[q, enter]
                    h[n - 1, q] = rows[n - 1, ids[q]]
            for q in range(n):
                support[i, q] = ids[q]
                share[i, q] = w[q]
            count[i] = n
            # keep the K largest: sort descending, stable
            for q in range(1, n):
                s = q
                while s > 0 and w[s] > w[s - 1]:
                    w[s], w[s - 1] = w[s - 1], w[s]
                    ids[s], ids[s - 1] = ids[s - 1], ids[s]
                    f[s], f[s - 1] = f[s - 1], f[s]
                    alive[s], alive[s - 1] = alive[s - 1], alive[s]
                    s -= 1
            if n > n_keep:
                n = n_keep
                total = 0.0
                for q in range(n):
                    total += w[q]
                for q in range(n):
                    w[q] /= total
                    # alive holds the row that each bone had before the sort
                    for s in range(n):
                        h[q, s] = rows[alive[q], ids[s]]
                for q in range(n):
                    alive[q] = q
                simplex_qp(h, f, w, alive, n, a, b)
        place(y[i], pairs, hold[i], ids, w, n, move_rest, p, form, g, a, b)
        error[i] = point_error(x2[i, 0], y[i, 0], form, ids, w, n, p[0])
        if p.shape[0] > 1 and length > 0.0:
            more = point_error(x2[i, 1], y[i, 1], form, ids, w, n, p[1])
            normal_error[i] = more / (length * length)
        store_points(p, length, rest[i], normals[i])
        if not locked[i]:
            store(ids, w, n, indices[i], weights[i])


@inline
def read_influences(indices, weights, ids, w):
    """Copy the influences of positive weight to `ids` and `w`, and return their number."""
    n = 0
    for q in range(weights.shape[0]):
        if weights[q] > 0.0:
            ids[n] = indices[q]
            w[n] = weights[q]
            n += 1
    return n


@inline
def store(ids, w, n, indices, weights):
    """Write n influences to `indices` and `weights`, normalised and in descending order.

    Unused influences get bone 0 and weight 0.
    """
    for q in range(1, n):
        s = q
        while s > 0 and w[s] > w[s - 1]:
            w[s], w[s - 1] = w[s - 1], w[s]
            ids[s], ids[s - 1] = ids[s - 1], ids[s]
            s -= 1
    total = 0.0
    for q in range(n):
        total += w[q]
    for q in range(weights.shape[0]):
        if q < n and w[q] > 0.0:
            indices[q] = ids[q]
            weights[q] = w[q] / total
        else:
            indices[q] = 0
            weights[q] = 0.0
