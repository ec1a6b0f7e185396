"""Small dense problems of many vertices at once: errors, Gauss–Newton systems, factors, inverses.

The last axis of all arrays is over LANES vertices, so that one instruction works on several
vertices.  Loops over this axis have a constant length, which needs no code for a remainder, and
read few other arrays: the compiler does not vectorise loops that read more.

All vertices have K influences here.  The weight of an unused influence is 0 and no unknown: its row
of the matrix is that of the identity.  Symbols are those of :mod:`.weights`.  ``blocks`` (N, 16)
are the 4×4 blocks G_qs of the pairs of influences q <= s, row by row, and ``along`` (K, P, 4) is
y_q.
"""

from __future__ import annotations

import numpy as np

from .policy import inline

LANES = 64


@inline
def forms(blocks, along, p, first, last, h, f):
    """Set h (K, K), in its upper triangle, and f (K): the error of points is wᵀhw − 2fᵀw + x2.

    The points are first..last of p (P, 3), of which the first is (p, 1) and the others (p, 0).
    """
    n_keep = len(f)
    f[:] = 0.0
    h[:] = 0.0
    for t in range(first, last):
        x, y, z = p[t, 0], p[t, 1], p[t, 2]
        pair = 0
        for q in range(n_keep):
            out = f[q]
            of = along[q, t]
            y0, y1, y2, y3 = of[0], of[1], of[2], of[3]
            for k in range(LANES):
                out[k] += y0[k] * x[k] + y1[k] * y[k] + y2[k] * z[k]
            if t == 0:
                for k in range(LANES):
                    out[k] += y3[k]
            for s in range(q, n_keep):
                g = blocks[pair]
                out = h[q, s]
                pair += 1
                for c in range(3):
                    at = p[t, c]
                    g0, g1, g2 = g[4 * c], g[4 * c + 1], g[4 * c + 2]
                    for k in range(LANES):
                        out[k] += at[k] * (g0[k] * x[k] + g1[k] * y[k] + g2[k] * z[k])
                    if t == 0:
                        g0, g1 = g[4 * c + 3], g[12 + c]
                        for k in range(LANES):
                            out[k] += at[k] * (g0[k] + g1[k])
                if t == 0:
                    g0 = g[15]
                    for k in range(LANES):
                        out[k] += g0[k]


@inline
def errors(h, f, w, x2, out):
    """Set `out` to the squared error wᵀhw − 2fᵀw + x2."""
    n_keep = len(f)
    out[:] = x2
    for q in range(n_keep):
        u, v, at = h[q, q], f[q], w[q]
        for k in range(LANES):
            out[k] += at[k] * (at[k] * u[k] - 2.0 * v[k])
        for s in range(q + 1, n_keep):
            u, v = h[q, s], w[s]
            for k in range(LANES):
                out[k] += 2.0 * at[k] * v[k] * u[k]


@inline
def add_pull(pull, p, out):
    """Add the error μ |p − m|² of the pulls (μ, m) on the rest positions p[0]."""
    for c in range(3):
        mu, m, at = pull[0], pull[1 + c], p[0, c]
        for k in range(len(out)):
            out[k] += mu[k] * (at[k] - m[k]) ** 2


@inline
def blend(blocks, w, p, turned, mean):
    """Set turned (P, K, 3) = Σ_s w_s G_sq p̃ and the lower triangle of mean = Σ_qs w_q w_s G_qs."""
    n_keep = len(w)
    turned[:] = 0.0
    mean[:] = 0.0
    pair = 0
    for q in range(n_keep):
        for s in range(q, n_keep):
            g = blocks[pair]
            pair += 1
            u, v = w[q], w[s]
            for c in range(3):
                for d in range(c + 1):
                    out, g0, g1 = mean[c, d], g[4 * c + d], g[4 * d + c]
                    factor = 0.5 if s == q else 1.0
                    for k in range(LANES):
                        out[k] += factor * u[k] * v[k] * (g0[k] + g1[k])
            for t in range(p.shape[0]):
                x, y, z = p[t, 0], p[t, 1], p[t, 2]
                for c in range(3):
                    out = turned[t, s, c]
                    g0, g1, g2, g3 = g[4 * c], g[4 * c + 1], g[4 * c + 2], g[4 * c + 3]
                    for k in range(LANES):
                        out[k] += u[k] * (g0[k] * x[k] + g1[k] * y[k] + g2[k] * z[k])
                    if t == 0:
                        for k in range(LANES):
                            out[k] += u[k] * g3[k]
                    if s == q:
                        continue
                    out = turned[t, q, c]
                    g0, g1, g2, g3 = g[c], g[4 + c], g[8 + c], g[12 + c]
                    for k in range(LANES):
                        out[k] += v[k] * (g0[k] * x[k] + g1[k] * y[k] + g2[k] * z[k])
                    if t == 0:
                        for k in range(LANES):
                            out[k] += v[k] * g3[k]


@inline
def joint_system(along, pull, w, free, p, fixed, h, f, turned, mean, slope, a, g):
    """Set the Gauss–Newton matrix a and half gradient g from :func:`forms` and :func:`blend`.

    Points with an index below `fixed` do not move.
    """
    n_keep = len(f)
    for q in range(n_keep):
        out, u = slope[q], f[q]
        for k in range(LANES):
            out[k] = -u[k]
        for s in range(n_keep):
            u, v = h[min(q, s), max(q, s)], w[s]
            for k in range(LANES):
                out[k] += u[k] * v[k]
    for q in range(1, n_keep):
        out, u, v, m = g[q - 1], slope[q], slope[0], free[q]
        for k in range(LANES):
            out[k] = m[k] * (u[k] - v[k])
        for s in range(1, q + 1):
            out, m0 = a[q - 1, s - 1], free[s]
            h0, h1, h2, h3 = h[s, q], h[0, s], h[0, q], h[0, 0]
            for k in range(LANES):
                out[k] = m[k] * m0[k] * (h0[k] - h1[k] - h2[k] + h3[k])
        out = a[q - 1, q - 1]
        for k in range(LANES):
            out[k] += 1.0 - m[k]
    z = n_keep - 1
    for t in range(fixed, p.shape[0]):
        mu = pull[0]
        for c in range(3):
            out, u, v = g[z + c], p[t, c], pull[1 + c]
            held = 1.0 if t == 0 else 0.0
            for k in range(LANES):
                out[k] = held * mu[k] * (u[k] - v[k])
            for q in range(n_keep):
                u, v, m = turned[t, q, c], along[q, t, c], w[q]
                for k in range(LANES):
                    out[k] += m[k] * (u[k] - v[k])
            for q in range(1, n_keep):
                out, u, v, m = a[z + c, q - 1], turned[t, q, c], turned[t, 0, c], free[q]
                for k in range(LANES):
                    out[k] = m[k] * (u[k] - v[k])
            a[z + c, n_keep - 1 : z] = 0.0
            for d in range(c + 1):
                out, u = a[z + c, z + d], mean[c, d]
                held = 1.0 if t == 0 and d == c else 0.0
                for k in range(LANES):
                    out[k] = u[k] + held * mu[k]
        z += 3


@inline
def factor(a, n, ridge, least, scale, bad):
    """Scale a to a unit diagonal, add `ridge` and factor it into LDLᵀ (in place).

    The diagonal receives 1/D, or 0 where a pivot is not above `least`.  `bad` is set to 1 for a
    vertex with such a pivot, and to 0 for all others.
    """
    bad[:] = 0.0
    for j in range(n):
        u, out = a[j, j], scale[j]
        for k in range(LANES):
            out[k] = 1.0 / np.sqrt(u[k]) if u[k] > 0.0 else 0.0
            u[k] = 1.0 + ridge
        for i in range(j):
            v, u = scale[i], a[j, i]
            for k in range(LANES):
                u[k] *= out[k] * v[k]
    for j in range(n):
        pivot = a[j, j]
        for i in range(j):
            u, v = a[j, i], a[i, i]
            for k in range(LANES):
                scaled = u[k] * v[k]
                pivot[k] -= scaled * u[k]
                u[k] = scaled
        for k in range(LANES):
            bad[k] = bad[k] if pivot[k] > least else 1.0
            pivot[k] = 1.0 / pivot[k] if pivot[k] > least else 0.0
        for i in range(j + 1, n):
            out = a[i, j]
            for s in range(j):
                u, v = a[i, s], a[j, s]
                for k in range(LANES):
                    out[k] -= u[k] * v[k]


@inline
def solve(a, b, n):
    """Solve LDLᵀ x = b (in place)."""
    for i in range(n):
        out = b[i]
        for j in range(i):
            u, v = a[i, j], b[j]
            for k in range(LANES):
                out[k] -= u[k] * v[k]
    for i in range(n):
        out, u = b[i], a[i, i]
        for k in range(LANES):
            out[k] *= u[k]
    for i in range(n - 1, 0, -1):
        v = b[i]
        for j in range(i):
            out, u = b[j], a[i, j]
            for k in range(LANES):
                out[k] -= u[k] * v[k]


@inline
def invert(a, n, x):
    """Replace the factors of :func:`factor` by the inverse, in the lower triangle; x is scratch.

    Variables with a bad pivot depend on others and are not moved: their rows become 0.
    """
    for i in range(n):
        for j in range(i):
            out, u = x[i, j], a[i, j]
            for k in range(LANES):
                out[k] = -u[k]
            for s in range(j + 1, i):
                u, v = a[i, s], x[s, j]
                for k in range(LANES):
                    out[k] -= u[k] * v[k]
    for i in range(n):
        for j in range(i + 1):
            out = a[i, j]
            if j < i:
                u, v = a[i, i], x[i, j]
                for k in range(LANES):
                    out[k] = u[k] * v[k]
            for s in range(i + 1, n):
                u, v, d = x[s, i], x[s, j], a[s, s]
                for k in range(LANES):
                    out[k] += u[k] * v[k] * d[k]
