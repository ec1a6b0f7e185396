"""Small dense solves inside the vertex kernels: LDLᵀ, and a QP over a simplex."""

from __future__ import annotations

from .policy import inline

__all__ = ["RIDGE", "cholesky_solve", "simplex_qp"]

RIDGE = 1e-13  # of the trace: keeps bones that move alike from a division by zero


@inline
def cholesky_solve(a, b, n):
    """Solve a x = b in place, a overwritten by its LDLᵀ; False if not positive definite."""
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

    Primal active set: full steps on the free weights, cut short at the first
    that reaches zero, which is then left out.  Returns how many are left.
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
            # what a full step leaves at zero to rounding is zero
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
