"""The choice of each vertex's influences in the polish, the Gauss–Newton iteration on the bones."""

from __future__ import annotations

import numpy as np

from .policy import kernel
from .simplex_qp import cheapest_to_drop, qp_value, simplex_qp
from .vertices import holds, load_points, read_influences, store
from .weights import all_pulled, begin_qp, close_gaps, gradient_of_all, hessian_row, take_columns


@kernel
def choose_influences(y, x2, gram, rest, indices, weights, normals, length, locked, entering):
    """Solve the weights of each vertex and let bones enter; no vertex's error rises.

    y         (V, P, 4, B)  float64  Σ_t M_j^tᵀ v_i^t of position and normal, in
    x2        (V, P)        float64  Σ_t |v_i^t|², in
    gram      (B, 10, B)    float64  coefficients of p̃ᵀ G_jk p̃, in
    rest      (V, 3)        float64  rest positions, in
    indices   (V, K)        int32    bone of each influence, updated
    weights   (V, K)        float64  its weight, descending, updated
    normals   (V, P-1, 3)   float64  rest normals, in
    length    float                  length of a normal treated as a point, in
    locked    (V,)          bool     vertices that are left as they are, in

    Up to `entering` bones, those of smallest gradient, are tried.  Such a bone joins the vertex's
    influences, or replaces one if there are K already, provided that this lowers the error.
    """
    n_bones = gram.shape[0]
    n_keep = indices.shape[1]
    slots = n_keep + 1
    m, p = np.empty(10), np.empty((x2.shape[1], 4))
    f_all, grad, barred = np.empty(n_bones), np.empty(n_bones), np.empty(n_bones, dtype=np.bool_)
    rows, h, f = np.empty((slots, n_bones)), np.empty((slots, slots)), np.empty(slots)
    w, trial, best_w = np.empty(slots), np.empty(slots), np.empty(slots)
    ids, alive = np.empty(slots, dtype=np.uint32), np.empty(slots, dtype=np.uint32)
    outs = np.empty(3, dtype=np.int64)
    a, b, scale = np.empty((slots, slots)), np.empty(slots), np.empty(slots)
    full = np.empty((slots, 16 * ((slots + 15) // 16)))
    row = np.empty(full.shape[1])
    for i in range(len(rest)):
        if locked[i]:
            continue
        load_points(rest[i], normals[i], length, p)
        whole = x2[i].sum()
        n = read_influences(indices[i], weights[i], ids, w)
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
                lower = not barred[j] and (enter < 0 or grad[j] < grad[enter])
                if lower and not holds(ids, n, j):
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
            # first try all bones: if at most K weights stay positive, none has to be dropped
            outs[:] = -1
            for attempt in range(3):
                out = outs[attempt]
                if attempt > 0 and out < 0:
                    break
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
                value, positive = qp_value(h, f, trial, n + 1)
                if positive <= n_keep and value < best - 1e-14 * whole:
                    best = value
                    found = True
                    best_w[: n + 1] = trial[: n + 1]
                if attempt == 0:
                    if positive <= n_keep:
                        break
                    outs[1], outs[2], rise = cheapest_to_drop(h, trial, n + 1, a, full, row, scale)
                    if not value + rise < best:
                        break
            if found:
                n += 1
                w[:n] = best_w[:n]
            else:
                w[n] = 0.0
        # the largest weight comes first: it is the one that follows from the others
        store(ids, w, n, indices[i], weights[i])
