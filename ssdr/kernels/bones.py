"""Kernels of the bone step: sums over vertices, then the bones' transforms in each frame."""

from __future__ import annotations

import numpy as np

from .policy import inline, kernel

# Squared radii of a bone's vertices, in a mesh of unit size.
SPECK = 1e-6  # below this, the scale of the bone is hardly determined
POINT = 1e-12  # below this, the rotation of the bone would follow rounding errors
SMALLEST, LARGEST = 1e-4, 1e4  # bounds of a bone's scale, unless it starts outside
TOGETHER = 16  # frames that a sweep works on at a time
COLUMNS = 512  # number of columns of the trajectories that are summed at a time


@kernel
def bone_moments(indices, weights, points, importance, z, u, az):
    """Add up the sums over vertices from which the bones of every frame are solved.

    indices     (V, K)      int32    bone of each influence, in
    weights     (V, K)      float64  its weight, 0 in unused influences, in
    points      (V, 4)      float64  p̃: rest positions (p, 1), or rest normals (n, 0), in
    importance  (V,)        float64  factor of each vertex's error, in
    z           (V, r)      float64  trajectories, compressed to r coefficients, in
    u           (B, B, 10)  float64  upper triangle of Σ_i w_j w_k p̃p̃ᵀ for j <= k, added to
    az          (4, B, r)   float64  Σ_i w_j p̃ z_i, added to
    """
    n_bones = az.shape[1]
    r = z.shape[1]
    start = np.zeros(n_bones + 1, dtype=np.int64)
    for i in range(len(points)):
        p = points[i]
        for q in range(indices.shape[1]):
            w = importance[i] * weights[i, q]
            if w == 0.0:
                continue
            j = indices[i, q]
            start[j + 1] += 1
            for s in range(indices.shape[1]):
                k = indices[i, s]
                if k < j or weights[i, s] == 0.0:
                    continue
                ww = w * weights[i, s]
                c = 0
                for d in range(4):
                    for e in range(d, 4):
                        u[j, k, c] += ww * p[d] * p[e]
                        c += 1
    # Bone by bone, three vertices at a time, with columns that fit into the cache: otherwise each
    # weight would read and write four whole rows of az.
    for j in range(n_bones):
        start[j + 1] = start[j] + 3 * ((start[j + 1] + 2) // 3)
    who = np.zeros(start[n_bones], dtype=np.int64)
    a = np.zeros((4, start[n_bones]))
    place = np.zeros(n_bones, dtype=np.int64)
    for i in range(len(points)):
        for q in range(indices.shape[1]):
            w = importance[i] * weights[i, q]
            if w == 0.0:
                continue
            j = indices[i, q]
            k = start[j] + place[j]
            place[j] += 1
            who[k] = i
            for d in range(4):
                a[d, k] = w * points[i, d]
    for e in range(0, r, COLUMNS):
        f = min(r, e + COLUMNS)
        for j in range(n_bones):
            for k in range(start[j], start[j + 1], 3):
                z0, z1, z2 = z[who[k], e:f], z[who[k + 1], e:f], z[who[k + 2], e:f]
                a00, a01, a02 = a[0, k], a[0, k + 1], a[0, k + 2]
                a10, a11, a12 = a[1, k], a[1, k + 1], a[1, k + 2]
                a20, a21, a22 = a[2, k], a[2, k + 1], a[2, k + 2]
                a30, a31, a32 = a[3, k], a[3, k + 1], a[3, k + 2]
                r0, r1, r2, r3 = az[0, j, e:f], az[1, j, e:f], az[2, j, e:f], az[3, j, e:f]
                for c in range(f - e):
                    x, y, v = z0[c], z1[c], z2[c]
                    r0[c] += a00 * x + a01 * y + a02 * v
                    r1[c] += a10 * x + a11 * y + a12 * v
                    r2[c] += a20 * x + a21 * y + a22 * v
                    r3[c] += a30 * x + a31 * y + a32 * v


@inline
def horn(s, r):
    """Set r to the rotation R that maximises tr(Rᵀs), by Horn's 4×4 matrix K.

    The rotation's quaternion is the eigenvector of the largest eigenvalue of K.  To find it, K +
    cI, with c such that no eigenvalue is negative, is squared repeatedly and scaled to a trace of
    1; it converges to the projection onto the eigenvector.
    """
    k = np.empty((4, 4))
    square = np.empty((4, 4))
    k[0, 0] = s[0, 0] + s[1, 1] + s[2, 2]
    k[1, 1] = s[0, 0] - s[1, 1] - s[2, 2]
    k[2, 2] = s[1, 1] - s[0, 0] - s[2, 2]
    k[3, 3] = s[2, 2] - s[0, 0] - s[1, 1]
    k[1, 0] = s[2, 1] - s[1, 2]
    k[2, 0] = s[0, 2] - s[2, 0]
    k[3, 0] = s[1, 0] - s[0, 1]
    k[2, 1] = s[0, 1] + s[1, 0]
    k[3, 1] = s[0, 2] + s[2, 0]
    k[3, 2] = s[1, 2] + s[2, 1]
    size = 0.0
    for a in range(4):
        for b in range(a + 1):
            k[b, a] = k[a, b]
            size += k[a, b] * k[a, b]
    size = np.sqrt(2.0 * size)
    for a in range(4):
        k[a, a] += size
    trace = 4.0 * size
    for _ in range(60):
        for a in range(4):
            for b in range(4):
                k[a, b] /= trace
        trace = 0.0
        for a in range(4):
            for b in range(4):
                value = 0.0
                for c in range(4):
                    value += k[a, c] * k[c, b]
                square[a, b] = value
            trace += square[a, a]
        k[:] = square
        # converged: a projection is its own square
        if trace > 1.0 - 4e-16:
            break
    top = 0
    for a in range(1, 4):
        if k[a, a] > k[top, top]:
            top = a
    quaternion_matrix(k[0, top], k[1, top], k[2, top], k[3, top], r)


@inline
def quaternion_matrix(w, x, y, z, r):
    """Set r to the rotation matrix of a quaternion of any norm except 0."""
    n = 1.0 / np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * n, x * n, y * n, z * n
    r[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    r[0, 1] = 2.0 * (x * y - z * w)
    r[0, 2] = 2.0 * (x * z + y * w)
    r[1, 0] = 2.0 * (x * y + z * w)
    r[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    r[1, 2] = 2.0 * (y * z - x * w)
    r[2, 0] = 2.0 * (x * z - y * w)
    r[2, 1] = 2.0 * (y * z + x * w)
    r[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@inline
def turn_bone(m, wx, wy, wz, turn, old):
    """Multiply the 3×3 block of m from the right by exp(ω), a rotation about the bone's axes.

    The exponential is approximated by the quaternion (1, ω/2), to second order in ω.
    """
    quaternion_matrix(1.0, 0.5 * wx, 0.5 * wy, 0.5 * wz, turn)
    for c in range(3):
        for d in range(3):
            old[d] = m[c, d]
        for d in range(3):
            m[c, d] = 0.0
            for e in range(3):
                m[c, d] += old[e] * turn[e, d]


@inline
def transposed_product(a, b, out):
    """Set `out` (3, 3) to the product aᵀ b of the 3×3 blocks of a and b."""
    for c in range(3):
        for d in range(3):
            out[c, d] = 0.0
            for e in range(3):
                out[c, d] += a[e, c] * b[e, d]


@inline
def rotate_toward(s, r, a, turn, new):
    """Set r to the rotation R that maximises tr(Rᵀs), by Newton's method on SO(3) from r.

    Every local maximum is a global one.  If the negated Hessian tr(A)I − sym(A), with A = Rᵀs, is
    not positive definite or a step is long, :func:`horn` takes over.
    """
    size = 0.0
    for c in range(3):
        for d in range(3):
            size += s[c, d] * s[c, d]
    size = np.sqrt(size)
    if not size > 0.0:
        return
    for _ in range(12):
        transposed_product(r, s, a)
        trace = a[0, 0] + a[1, 1] + a[2, 2]
        h00, h11, h22 = trace - a[0, 0], trace - a[1, 1], trace - a[2, 2]
        h01 = -0.5 * (a[0, 1] + a[1, 0])
        h02 = -0.5 * (a[0, 2] + a[2, 0])
        h12 = -0.5 * (a[1, 2] + a[2, 1])
        gx, gy, gz = a[2, 1] - a[1, 2], a[0, 2] - a[2, 0], a[1, 0] - a[0, 1]
        # LDLᵀ of the Hessian; the step along a flat direction (collinear points) is damped
        floor = 1e-9 * size
        d0 = max(h00, floor)
        l10, l20 = h01 / d0, h02 / d0
        d1 = h11 - l10 * h01
        t12 = h12 - l20 * h01
        lost = h00 < -floor or d1 < -floor
        d1 = max(d1, floor)
        l21 = t12 / d1
        d2 = h22 - l20 * h02 - l21 * t12
        lost = lost or d2 < -floor
        d2 = max(d2, floor)
        y1 = gy - l10 * gx
        wz = (gz - l20 * gx - l21 * y1) / d2
        wy = y1 / d1 - l21 * wz
        wx = gx / d0 - l10 * wy - l20 * wz
        angle2 = wx * wx + wy * wy + wz * wz
        if lost or angle2 > 1.0:
            horn(s, r)
            return
        turn_bone(r, wx, wy, wz, turn, new[0])
        if angle2 < 1e-20:
            break
    # One Newton–Schulz step, since products of rotations drift from orthonormality
    transposed_product(r, r, a)
    for c in range(3):
        for d in range(3):
            new[c, d] = 1.5 * r[c, d]
            for e in range(3):
                new[c, d] -= 0.5 * r[c, e] * a[e, d]
    r[:] = new


@kernel
def sweep_bones(transforms, c, u, start, neighbour, scaled, sweeps):
    """Fit each bone given the others, one after the other, in `sweeps` passes (Gauss–Seidel).

    transforms  (F, B, 3, 4)  float64  bones, updated
    c           (F, 3, 4, B)  float64  Σ_i w_j v_i p̃ᵀ, in
    u           (B, B, 4, 4)  float64  Σ_i w_j w_k p̃p̃ᵀ, in
    start       (B + 1,)      int32    where each bone's entries of `neighbour` start, in
    neighbour   (N,)          int32    start[j]..start[j + 1]: other bones that share vertices with
                                       bone j, in

    If `scaled`, the 3×3 blocks are scaled rotations (Umeyama 1991), otherwise rotations.
    """
    n_bones = transforms.shape[1]
    # frames last, so that one instruction works on several of them
    bones = np.empty((n_bones, 3, 4, TOGETHER))
    d = np.empty((3, 4, TOGETHER))
    s, r, a = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    turn, new = np.empty((3, 3)), np.empty((3, 3))
    for first in range(0, len(transforms), TOGETHER):
        n_frames = min(TOGETHER, len(transforms) - first)
        for t in range(n_frames):
            bones[:, :, :, t] = transforms[first + t]
        for _ in range(sweeps):
            for j in range(n_bones):
                own = u[j, j]
                mass = own[3, 3]
                if not mass > 0.0:
                    continue
                for e in range(3):
                    for f in range(4):
                        for t in range(n_frames):
                            d[e, f, t] = c[first + t, e, f, j]
                for q in range(start[j], start[j + 1]):
                    k = neighbour[q]
                    for e in range(3):
                        of = bones[k, e]
                        m0, m1, m2, m3 = of[0], of[1], of[2], of[3]
                        for f in range(4):
                            row = d[e, f]
                            w = u[j, k, :, f]
                            v0, v1, v2, v3 = w[0], w[1], w[2], w[3]
                            for t in range(n_frames):
                                row[t] = row[t] - m0[t] * v0 - m1[t] * v1 - m2[t] * v2 - m3[t] * v3
                extent = 0.0
                for e in range(3):
                    extent += own[e, e] - own[e, 3] * own[3, e] / mass
                for t in range(n_frames):
                    m = bones[j, :, :, t]
                    size = 1.0
                    if scaled:
                        size = np.sqrt(m[0, 0] * m[0, 0] + m[1, 0] * m[1, 0] + m[2, 0] * m[2, 0])
                    for e in range(3):
                        for f in range(3):
                            s[e, f] = d[e, f, t] - d[e, 3, t] * own[3, f] / mass
                            r[e, f] = m[e, f] / size
                    if extent > POINT * mass:
                        rotate_toward(s, r, a, turn, new)
                    if scaled:
                        # regularised towards the present scale, which a bone without extent keeps
                        spread = SPECK * mass
                        pull = spread * size
                        spread += extent
                        for e in range(3):
                            for f in range(3):
                                pull += r[e, f] * s[e, f]
                        size = min(max(pull / spread, min(size, SMALLEST)), max(size, LARGEST))
                    for e in range(3):
                        for f in range(3):
                            m[e, f] = size * r[e, f]
                        m[e, 3] = d[e, 3, t] / mass
                        for f in range(3):
                            m[e, 3] -= m[e, f] * own[f, 3] / mass
        for t in range(n_frames):
            transforms[first + t] = bones[:, :, :, t]
