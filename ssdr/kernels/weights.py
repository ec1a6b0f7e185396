"""The problem wᵀHw − 2fᵀw in the weights w of one vertex, for a given rest position and normal.

A vertex i has the rest position p, with p̃ = (p, 1), and the weights w.  Its squared error is x2_i
− 2 fᵀw + wᵀHw, with H_jk = p̃ᵀ G_jk p̃ and f_j = p̃ᵀ y_ij for bones j and k.  Here G_jk = Σ_t
M_j^tᵀ M_k^t is a 4×4 matrix, and the vector y_ij = Σ_t M_j^tᵀ v_i^t is ``y[i, 0, :, j]``.
``gram[j, :, k]`` are the ten coefficients of p̃ᵀ G_jk p̃ as a polynomial in the monomials x², y²,
z², xy, xz, yz, x, y, z, 1, so that a row of H is a sum of ten vectors.

If a vertex also has a normal n, it follows the same bones as a point (n, 0) with the same weights:
H and f are the sums over both points, ``p[0]`` = (p, 1) and ``p[1]`` = (l n, 0), where the length l
says how much the error of the normal counts.  A pull (μ, m) adds μ |p − m|² to the error.
"""

from __future__ import annotations

from .policy import inline


@inline
def monomials(p, m):
    """Set m to the sums of the ten monomials of the points p (P, 4), in the order of ``gram``."""
    x, y, z = p[0, 0], p[0, 1], p[0, 2]
    m[0] = x * x
    m[1] = y * y
    m[2] = z * z
    m[3] = x * y
    m[4] = x * z
    m[5] = y * z
    m[6] = x
    m[7] = y
    m[8] = z
    m[9] = 1.0
    for t in range(1, p.shape[0]):
        x, y, z = p[t, 0], p[t, 1], p[t, 2]
        m[0] += x * x
        m[1] += y * y
        m[2] += z * z
        m[3] += x * y
        m[4] += x * z
        m[5] += y * z


@inline
def hessian_row(gram, j, m, row):
    """Set `row` to row j of H for one vertex, given the monomials m of its points."""
    for k in range(gram.shape[2]):
        row[k] = (
            gram[j, 9, k]
            + m[0] * gram[j, 0, k]
            + m[1] * gram[j, 1, k]
            + m[2] * gram[j, 2, k]
            + m[3] * gram[j, 3, k]
        )
    for k in range(gram.shape[2]):
        row[k] += (
            m[4] * gram[j, 4, k]
            + m[5] * gram[j, 5, k]
            + m[6] * gram[j, 6, k]
            + m[7] * gram[j, 7, k]
            + m[8] * gram[j, 8, k]
        )


@inline
def pulled(y, j, p):
    """Linear coefficient f_j = Σ p̃ᵀ y_j of the weight of bone j, summed over the points p̃."""
    value = y[0, 3, j]
    for d in range(3):
        value += y[0, d, j] * p[0, d]
    for t in range(1, p.shape[0]):
        for d in range(3):
            value += y[t, d, j] * p[t, d]
    return value


@inline
def all_pulled(y, p, f):
    """Set f to the linear coefficients of the weights of all bones, as :func:`pulled`."""
    for j in range(len(f)):
        f[j] = y[0, 3, j] + p[0, 0] * y[0, 0, j] + p[0, 1] * y[0, 1, j] + p[0, 2] * y[0, 2, j]
    for t in range(1, p.shape[0]):
        for j in range(len(f)):
            f[j] += p[t, 0] * y[t, 0, j] + p[t, 1] * y[t, 1, j] + p[t, 2] * y[t, 2, j]


@inline
def begin_qp(y, gram, ids, n, p, m, rows, h, f, alive):
    """Set up the problem in the weights of n bones at the points p (P, 4), all of them free.

    m      (10,)    float64  monomials of the points, out
    rows   (S, B)   float64  rows of H of the n bones, out
    h      (S, S)   float64  columns of `rows` at the n bones, out
    f      (S,)     float64  linear coefficients, out
    alive  (S,)     uint32   0 to n − 1, out
    """
    monomials(p, m)
    for q in range(n):
        hessian_row(gram, ids[q], m, rows[q])
        f[q] = pulled(y, ids[q], p)
    take_columns(rows, ids, n, h, alive)


@inline
def take_columns(rows, ids, n, h, alive):
    """Set h (n, n) to the columns of `rows` at n bones, and `alive` to 0..n − 1: all are free."""
    for q in range(n):
        alive[q] = q
        for s in range(n):
            h[q, s] = rows[q, ids[s]]


@inline
def gradient_of_all(f_all, rows, w, n, grad):
    """Set `grad` to Hw − f, half the error's gradient with respect to all bones' weights."""
    for j in range(len(grad)):
        grad[j] = -f_all[j]
    for q in range(n):
        s = w[q]
        for j in range(len(grad)):
            grad[j] += s * rows[q, j]


@inline
def close_gaps(ids, w, f, rows, n):
    """Remove bones of weight 0 from the first n slots (in place); return the number left."""
    left = 0
    for q in range(n):
        if w[q] > 0.0:
            if left != q:
                ids[left] = ids[q]
                w[left] = w[q]
                f[left] = f[q]
                for k in range(rows.shape[1]):
                    rows[left, k] = rows[q, k]
            left += 1
    return left
