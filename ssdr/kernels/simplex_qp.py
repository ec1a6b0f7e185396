"""Small dense problems of the vertex kernels: linear systems, inverses, a QP over a simplex."""

from __future__ import annotations

import numpy as np

from .policy import inline

# This fraction of the mean diagonal is added to the diagonal, since bones that move alike make a
# matrix singular.
RIDGE = 1e-13


@inline
def cholesky_solve(a, b, n):
    """Solve a x = b, overwriting b by x; return False if a is not positive definite.

    Only the lower triangle of a (n, n) is read; it is overwritten by its LDLᵀ factors.
    """
    trace = 0.0
    for i in range(n):
        trace += a[i, i]
    floor = RIDGE * trace / max(n, 1)
    for i in range(n):
        a[i, i] += floor
    for j in range(n):
        if not a[j, j] > 0.0:
            return False
        scale = 1.0 / a[j, j]
        for i in range(j + 1, n):
            s = a[i, j] * scale
            for k in range(j + 1, i + 1):
                a[i, k] -= s * a[k, j]
            b[i] -= s * b[j]
        for i in range(j + 1, n):
            a[i, j] *= scale
        b[j] *= scale
    for i in range(n - 1, 0, -1):
        s = b[i]
        for k in range(i):
            b[k] -= s * a[i, k]
    return True


@inline
def qp_value(h, f, w, n):
    """The value wᵀhw − 2fᵀw of n weights, and how many of them are positive."""
    value, positive = 0.0, 0
    for q in range(n):
        if w[q] > 0.0:
            positive += 1
            value -= 2.0 * w[q] * f[q]
            for s in range(n):
                value += w[q] * w[s] * h[q, s]
    return value, positive


@inline
def simplex_qp(h, f, w, alive, n, a, b):
    """Minimise wᵀhw − 2fᵀw over weights w ≥ 0 with sum 1 (in place), and return how many stay free.

    Only the weights ``alive[:n]`` are free, and w must be feasible.  By the primal active-set
    method, each step leads towards the minimum over the free weights, but stops where the first
    weight becomes 0; that weight is then removed from `alive`.
    """
    while n > 1:
        top = 0
        for q in range(1, n):
            if w[alive[q]] > w[alive[top]]:
                top = q
        r = alive[top]
        alive[top] = alive[n - 1]
        alive[n - 1] = r
        h_rr = h[r, r]
        g_r = -f[r]
        for q in range(n):
            g_r += h[r, alive[q]] * w[alive[q]]
        for q in range(n - 1):
            c = alive[q]
            g = -f[c]
            h_cr = h[c, r]
            for s in range(n):
                g += h[c, alive[s]] * w[alive[s]]
            b[q] = g_r - g
            for s in range(q + 1):
                d = alive[s]
                a[q, s] = h[c, d] - h_cr - h[r, d] + h_rr
        if not cholesky_solve(a, b, n - 1):
            return n
        step = 1.0
        block = -1
        total = 0.0
        for q in range(n - 1):
            c = alive[q]
            total += b[q]
            if w[c] + b[q] < 0.0 and w[c] < -step * b[q]:
                step = -w[c] / b[q]
                block = q
        if w[r] - total < 0.0 and w[r] < step * total:
            step = w[r] / total
            block = n - 1
        for q in range(n - 1):
            w[alive[q]] += step * b[q]
        w[r] -= step * total
        if block < 0:
            # after a full step, weights that rounding left below zero are dropped
            q = 0
            while q < n:
                if w[alive[q]] <= 0.0:
                    w[alive[q]] = 0.0
                    n -= 1
                    alive[q] = alive[n]
                else:
                    q += 1
            return n
        w[alive[block]] = 0.0
        n -= 1
        alive[block] = alive[n]
    return n


@inline
def invert(a, n, full, row):
    """Invert a positive definite matrix with unit diagonal.

    a     (n, n)     float64  lower triangle of the matrix, in
    full  (n, 16m)   float64  inverse in the first n columns, out; 16m is at least n
    row   (16m,)     float64  scratch
    """
    width = 16 * ((n + 15) // 16)
    for i in range(n):
        for j in range(n, width):
            full[i, j] = 0.0
        for j in range(i):
            full[i, j] = a[i, j]
            full[j, i] = a[i, j]
        full[i, i] = a[i, i] + 1e-9
    for k in range(n):
        pivot = full[k, k]
        # a pivot that is only rounding: the variable depends on others and is not moved
        d = 1.0 / pivot if pivot > 1e-12 else 0.0
        for j in range(width):
            row[j] = full[k, j] * d
        row[k] = d
        for i in range(n):
            f = full[i, k]
            full[i, k] = 0.0
            for j in range(width):
                full[i, j] -= f * row[j]
        for j in range(width):
            full[k, j] = row[j]


@inline
def cheapest_to_drop(h, w, n, a, full, row, scale):
    """Indices of the two weights cheapest to remove, and the rise of the error without the first.

    The last of the n weights is no candidate.  An index is −1 if there is no such weight.  a, full,
    row and scale are scratch.

    Removing weight q raises the error by w_q² / P_qq, where P is the inverse of h restricted to
    changes of the weights that keep their sum.  This is exact if the other weights stay positive;
    otherwise the error rises more.
    """
    last = n - 1
    for q in range(last):
        for s in range(q + 1):
            a[q, s] = h[q, s] - h[last, s] - h[q, last] + h[last, last]
        scale[q] = 1.0 / np.sqrt(a[q, q]) if a[q, q] > 0.0 else 0.0
        a[q, q] = 1.0
        for s in range(q):
            a[q, s] *= scale[q] * scale[s]
    invert(a, last, full, row)
    first = second = -1
    least = next_least = np.inf
    for q in range(last):
        curvature = full[q, q] * scale[q] * scale[q]
        loss = w[q] * w[q] / curvature if curvature > 0.0 else 0.0
        if loss < least:
            first, second = q, first
            least, next_least = loss, least
        elif loss < next_least:
            second = q
            next_least = loss
    return first, second, least
