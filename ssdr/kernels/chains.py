"""Kernels of bones that are connected by joints: tangents, Gauss–Newton matrices, moves.

A bone j with parent k and joint c_j, a point of the rest pose, satisfies M_j c_j = M_k c_j in
every frame; a root is free.  The unknowns of a frame are a rotation ω_j of every bone and a
translation τ_j of every root, in the bone's axes.  The changes δc_j of the joints are unknowns
shared by all frames.  The tangents (ω, τ) of a bone change M by δM = M [[ω]× τ; 0 0].
"""

from __future__ import annotations

import numpy as np

from .bones import transposed_product, turn_bone
from .policy import inline, kernel


@kernel
def chain_image(transforms, order, parents, points, turns, shifts, moved, out):
    """Compute the tangents (ω, τ) of all bones, given the unknowns.

    transforms  (F, B, 3, 4)  float64  transforms of the bones, in
    order       (B,)          int64    bones, parents before children, in
    parents     (B,)          int64    parent of each bone, −1 for a root, in
    points      (B, 3)        float64  joints in the rest pose, in
    turns       (F, B, 3)     float64  ω, in
    shifts      (F, B, 3)     float64  τ of the roots, in; other rows are not read
    moved       (B, 3)        float64  δc, changes of the joints, in
    out         (F, B, 6)     float64  tangents, out
    """
    n_bones = len(parents)
    a = np.empty(3)
    for t in range(len(transforms)):
        for i in range(n_bones):
            j = order[i]
            k = parents[j]
            o = out[t, j]
            w = turns[t, j]
            for d in range(3):
                o[d] = w[d]
            if k < 0:
                for d in range(3):
                    o[3 + d] = shifts[t, j, d]
                continue
            c = points[j]
            p = out[t, k]
            m, n = transforms[t, k], transforms[t, j]
            # velocity of the joint as a point of the parent, in world axes
            b0 = p[1] * c[2] - p[2] * c[1] + p[3] + moved[j, 0]
            b1 = p[2] * c[0] - p[0] * c[2] + p[4] + moved[j, 1]
            b2 = p[0] * c[1] - p[1] * c[0] + p[5] + moved[j, 2]
            for d in range(3):
                a[d] = m[d, 0] * b0 + m[d, 1] * b1 + m[d, 2] * b2
            for d in range(3):
                o[3 + d] = n[0, d] * a[0] + n[1, d] * a[1] + n[2, d] * a[2] - moved[j, d]
            o[3] -= w[1] * c[2] - w[2] * c[1]
            o[4] -= w[2] * c[0] - w[0] * c[2]
            o[5] -= w[0] * c[1] - w[1] * c[0]


@kernel
def chain_pullback(transforms, order, parents, points, g, turns, shifts, moved):
    """Pull a gradient back through :func:`chain_image`, by its transpose; g is overwritten.

    g       (F, B, 6)  float64  gradient with respect to the tangents, in
    turns   (F, B, 3)  float64  gradient with respect to ω, out
    shifts  (F, B, 3)  float64  gradient with respect to τ of the roots, 0 at other bones, out
    moved   (B, 3)     float64  gradient with respect to δc; the result is added to it
    """
    n_bones = len(parents)
    a = np.empty(3)
    for t in range(len(transforms)):
        for i in range(n_bones - 1, -1, -1):
            j = order[i]
            k = parents[j]
            o = g[t, j]
            if k < 0:
                for d in range(3):
                    turns[t, j, d] = o[d]
                    shifts[t, j, d] = o[3 + d]
                continue
            c = points[j]
            m, n = transforms[t, k], transforms[t, j]
            turns[t, j, 0] = o[0] + o[4] * c[2] - o[5] * c[1]
            turns[t, j, 1] = o[1] + o[5] * c[0] - o[3] * c[2]
            turns[t, j, 2] = o[2] + o[3] * c[1] - o[4] * c[0]
            for d in range(3):
                shifts[t, j, d] = 0.0
                a[d] = n[d, 0] * o[3] + n[d, 1] * o[4] + n[d, 2] * o[5]
            h0 = m[0, 0] * a[0] + m[1, 0] * a[1] + m[2, 0] * a[2]
            h1 = m[0, 1] * a[0] + m[1, 1] * a[1] + m[2, 1] * a[2]
            h2 = m[0, 2] * a[0] + m[1, 2] * a[1] + m[2, 2] * a[2]
            p = g[t, k]
            p[0] += c[1] * h2 - c[2] * h1
            p[1] += c[2] * h0 - c[0] * h2
            p[2] += c[0] * h1 - c[1] * h0
            p[3] += h0
            p[4] += h1
            p[5] += h2
            moved[j, 0] += h0 - o[3]
            moved[j, 1] += h1 - o[4]
            moved[j, 2] += h2 - o[5]


@inline
def substitute(a, j, p, c, turn, old):
    """Replace the unknown τ_j by δc in the columns of the matrix a (B, 6, B, 6).

    It substitutes τ_j = P (ω_p × c + τ_p + δc) − ω_j × c − δc, where p is the parent of j, c the
    joint between them, and P = R_jᵀR_p, which is `turn`.
    """
    for k in range(a.shape[0]):
        for g in range(6):
            row = a[k, g]
            for d in range(3):
                old[d] = row[j, 3 + d]
            for d in range(3):
                e, f = (d + 1) % 3, (d + 2) % 3
                row[j, d] += old[e] * c[f] - old[f] * c[e]
            h0 = turn[0, 0] * old[0] + turn[1, 0] * old[1] + turn[2, 0] * old[2]
            h1 = turn[0, 1] * old[0] + turn[1, 1] * old[1] + turn[2, 1] * old[2]
            h2 = turn[0, 2] * old[0] + turn[1, 2] * old[1] + turn[2, 2] * old[2]
            row[p, 0] += c[1] * h2 - c[2] * h1
            row[p, 1] += c[2] * h0 - c[0] * h2
            row[p, 2] += c[0] * h1 - c[1] * h0
            row[p, 3] += h0
            row[p, 4] += h1
            row[p, 5] += h2
            row[j, 3] = h0 - old[0]
            row[j, 4] = h1 - old[1]
            row[j, 5] = h2 - old[2]


@kernel
def chain_matrix(transforms, order, parents, points, u, scale, out):
    """Add up the Gauss–Newton matrices of all frames in the unknowns of the tree.

    u      (B, B, 4, 4)  float64  Σ_i w_j w_k p̃p̃ᵀ, in
    scale  (F,)          float64  importance of each frame, in
    out    (B, 6, B, 6)  float64  the sum is added to it; the six unknowns of bone j are ω_j,
                                  then τ_j for a root and δc_j for another bone
    """
    n_bones = len(parents)
    a = np.empty((n_bones, 6, n_bones, 6))
    r, turn, old = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for t in range(len(transforms)):
        for j in range(n_bones):
            for k in range(j, n_bones):
                v = u[j, k]
                if v[3, 3] == 0.0:
                    a[j, :, k] = 0.0
                    a[k, :, j] = 0.0
                    continue
                transposed_product(transforms[t, j], transforms[t, k], r)
                r *= scale[t]
                # δ(M p) = R (ω × p + τ): a block is Σ w_j w_k JᵀR_jᵀR_k J, with J the derivative
                # of ω × p + τ
                for d in range(3):
                    for e in range(3):
                        a[j, 3 + d, k, 3 + e] = r[d, e] * v[3, 3]
                    for e in range(3):
                        f, h = (e + 1) % 3, (e + 2) % 3
                        # ω_e adds −ω_e p_h to (ω × p)_f and ω_e p_f to (ω × p)_h
                        a[j, 3 + d, k, e] = r[d, h] * v[3, f] - r[d, f] * v[3, h]
                        a[j, e, k, 3 + d] = r[h, d] * v[f, 3] - r[f, d] * v[h, 3]
                for d in range(3):
                    d1, d2 = (d + 1) % 3, (d + 2) % 3
                    for e in range(3):
                        e1, e2 = (e + 1) % 3, (e + 2) % 3
                        a[j, d, k, e] = (
                            r[d2, e2] * v[d1, e1]
                            - r[d2, e1] * v[d1, e2]
                            - r[d1, e2] * v[d2, e1]
                            + r[d1, e1] * v[d2, e2]
                        )
                if k > j:
                    a[k, :, j] = a[j, :, k].T
        for i in range(n_bones - 1, -1, -1):
            j = order[i]
            p = parents[j]
            if p < 0:
                continue
            transposed_product(transforms[t, j], transforms[t, p], turn)
            # substitute in the columns, then in the rows
            substitute(a, j, p, points[j], turn, old)
            substitute(a.transpose(2, 3, 0, 1), j, p, points[j], turn, old)
        out += a


@kernel
def chain_move(transforms, order, parents, points, turns, shifts):
    """Rotate every bone by exp(ω), translate roots by τ, and others so that joints connect again.

    transforms  (F, B, 3, 4)  float64  transforms of the bones, updated
    points      (B, 3)        float64  joints in the rest pose after their change, in

    The other arguments are those of :func:`chain_image`.
    """
    n_bones = len(parents)
    turn, old = np.empty((3, 3)), np.empty(3)
    for t in range(len(transforms)):
        for i in range(n_bones):
            j = order[i]
            k = parents[j]
            m = transforms[t, j]
            if k < 0:
                for c in range(3):
                    for d in range(3):
                        m[c, 3] += m[c, d] * shifts[t, j, d]
            turn_bone(m, turns[t, j, 0], turns[t, j, 1], turns[t, j, 2], turn, old)
            if k >= 0:
                p = points[j]
                n = transforms[t, k]
                for c in range(3):
                    m[c, 3] = n[c, 3]
                    for d in range(3):
                        m[c, 3] += (n[c, d] - m[c, d]) * p[d]
