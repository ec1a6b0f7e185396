"""Kernel of the rise of the error if a bone is removed."""

from __future__ import annotations

import numpy as np

from .policy import kernel
from .simplex_qp import simplex_qp
from .weight_problem import begin_qp, pulled


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
    m = np.empty(10)
    rows = np.empty((n_slots, n_bones))
    h = np.empty((n_slots, n_slots))
    f = np.empty(n_slots)
    w = np.empty(n_slots)
    alive = np.empty(n_slots, dtype=np.uint32)
    a = np.empty((n_slots, n_slots))
    b = np.empty(n_slots)
    p = np.empty((1, 4))
    p[0, 3] = 1.0
    ids = np.empty(n_slots, dtype=np.uint32)
    for i in range(len(rest)):
        for c in range(3):
            p[0, c] = rest[i, c]
        n = count[i]
        for q in range(n):
            ids[q] = support[i, q]
        begin_qp(y[i], gram, ids, n, p, m, rows, h, f, alive)
        base = 0.0
        for q in range(n):
            base -= 2.0 * share[i, q] * f[q]
            for s in range(n):
                base += share[i, q] * share[i, s] * h[q, s]
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
                    alive[left] = s
                    left += 1
            for s in range(left):
                if rest_share > 1e-12:
                    w[alive[s]] = share[i, alive[s]] / rest_share
                else:
                    w[alive[s]] = 1.0 / left
            simplex_qp(h, f, w, alive, left, a, b)
            value = 0.0
            for s in range(n):
                if w[s] > 0.0:
                    value -= 2.0 * w[s] * f[s]
                    for c in range(n):
                        value += w[s] * w[c] * h[s, c]
            cost[support[i, q]] += importance[i] * (value - base)
