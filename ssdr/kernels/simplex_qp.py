"""Small dense problems inside the vertex kernels: LDLᵀ, inverses, a QP over a simplex."""

from __future__ import annotations

import numpy as np

from .policy import inline

__all__ = [
    "RIDGE",
    "cheapest_to_drop",
    "cholesky_solve",
    "equilibrate",
    "invert",
    "simplex_qp",
]

RIDGE = 1e-13  # of the mean diagonal, added to it: bones that move alike make a matrix singular


@inline
def cholesky_solve(a, b, n):
    """Solve a x = b: b becomes x, a its LDLᵀ; False if a is not positive definite."""
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
def simplex_qp(h, f, w, alive, n, a, b):
    """Minimise wᵀhw − 2fᵀw over the simplex spanned by ``alive[:n]``, from a feasible w.

    Primal active set: a step to the minimum over the free weights is cut at the first that reaches
    zero, which is then left out.  Returns the number of weights left.
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
def equilibrate(a, n, scale):
    """Scale the lower triangle to a unit diagonal, since weights and lengths differ in size."""
    for q in range(n):
        scale[q] = 1.0 / np.sqrt(a[q, q]) if a[q, q] > 0.0 else 0.0
    for q in range(n):
        for s in range(q):
            a[q, s] *= scale[q] * scale[s]
        a[q, q] = 1.0


@inline
def invert(a, n, full, row):
    """Inverse of an equilibrated positive definite matrix.

    a     (n, n)     float64  its lower triangle, in
    full  (n, 16m)   float64  the inverse, out; 16m at least n
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
        # a pivot of rounding errors: the variable depends on others and is not moved
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
    """The two of n positive weights, the last not among them, whose removal costs least.

    The error rises by w_q² / P_qq, with P the inverse of h restricted to changes that keep the
    sum.  This is exact if the other weights stay positive.
    """
    last = n - 1
    for q in range(last):
        for s in range(q + 1):
            a[q, s] = h[q, s] - h[last, s] - h[q, last] + h[last, last]
    equilibrate(a, last, scale)
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
    return first, second
