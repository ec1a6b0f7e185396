"""Kernel of the rise of the error if a bone is removed."""

from __future__ import annotations

import numpy as np

from .policy import kernel
from .simplex_qp import qp_value, simplex_qp
from .weights import begin_qp, pulled


@kernel
def removal_cost(y, gram, rest, support, share, count, importance, cost):
    """Add up, for each bone, the rise of the vertices' errors if the bone is removed.

    y           (V, 1, 4, B) float64  Σ_t M_j^tᵀ v_i^t, in
    gram        (B, 10, B)  float64  coefficients of p̃ᵀ G_jk p̃, in
    rest        (V, 3)      float64  rest positions, in
    support     (V, S)      int32    bones of each vertex before the reduction to K, in
    share       (V, S)      float64  weights of the bones in `support`, in
    count       (V,)        int32    number of used slots of `support`, in
    importance  (V,)        float64  factor of each vertex's error, in
    cost        (B,)        float64  rise of the error, added to
    """
    n_slots = support.shape[1]
    n_bones = gram.shape[0]
    m, p = np.empty(10), np.ones((1, 4))
    rows, f, w = np.empty((n_slots, n_bones)), np.empty(n_slots), np.empty(n_slots)
    ids, alive = np.empty(n_slots, dtype=np.uint32), np.empty(n_slots, dtype=np.uint32)
    h, a, b = np.empty((n_slots, n_slots)), np.empty((n_slots, n_slots)), np.empty(n_slots)
    for i in range(len(rest)):
        p[0, :3] = rest[i]
        n = count[i]
        for q in range(n):
            ids[q] = support[i, q]
        begin_qp(y[i], gram, ids, n, p, m, rows, h, f, alive)
        base, _ = qp_value(h, f, share[i], n)
        if n == 1:
            # the vertex would follow the best other bone alone
            best = np.inf
            for j in range(n_bones):
                diagonal = gram[j, 9, j]
                for c in range(9):
                    diagonal += m[c] * gram[j, c, j]
                if j != support[i, 0]:
                    best = min(best, diagonal - 2.0 * pulled(y[i], j, p))
            cost[support[i, 0]] += importance[i] * (best - base)
            continue
        for q in range(n):
            left = 0
            rest_share = 1.0 - share[i, q]
            for s in range(n):
                w[s] = 0.0
                if s != q:
                    w[s] = share[i, s] / rest_share if rest_share > 1e-12 else 1.0 / (n - 1)
                    alive[left] = s
                    left += 1
            simplex_qp(h, f, w, alive, left, a, b)
            value, _ = qp_value(h, f, w, n)
            cost[support[i, q]] += importance[i] * (value - base)
