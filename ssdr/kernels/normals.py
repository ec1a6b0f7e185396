"""Kernels of normals: those of a surface, the sums that fit rest normals, and angles."""

from __future__ import annotations

import math

from .policy import kernel

_FLAT = 1e-9  # least area of a triangle, relative to the square of its longest edge
_CANCELLED = 1e-9  # least norm of a sum of unit normals times angles in radians


@kernel
def normals_range(frames, faces, corners, out, first, last):
    """Compute the normals of a surface, weighted by the triangles' angles, in frames first..last.

    frames   (F, V, 3)  float64  vertices, in
    faces    (T, 3)     int32    triangles, in
    corners  (T, 3)     int32    index of the normal at each corner, in
    out      (F, N, 3)  float64  unit normals, written for frames first..last; 0 where no triangle
                                 has an area, or the sum cancels
    """
    for t in range(first, last):
        x, n = frames[t], out[t]
        n[:] = 0.0
        for k in range(len(faces)):
            i, j, m = faces[k, 0], faces[k, 1], faces[k, 2]
            ux, uy, uz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
            vx, vy, vz = x[m, 0] - x[i, 0], x[m, 1] - x[i, 1], x[m, 2] - x[i, 2]
            nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            size = math.sqrt(nx * nx + ny * ny + nz * nz)
            uu, vv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
            uv = ux * vx + uy * vy + uz * vz
            # not "<=", so that a triangle that is not finite has no area, either
            if not size > _FLAT * max(uu, vv, uu + vv - 2 * uv):
                continue
            a, b = math.atan2(size, uv), math.atan2(size, uu - uv)
            nx, ny, nz = nx / size, ny / size, nz / size
            for c in range(3):
                share = a if c == 0 else b if c == 1 else math.pi - a - b
                h = corners[k, c]
                n[h, 0] += share * nx
                n[h, 1] += share * ny
                n[h, 2] += share * nz
        for h in range(len(n)):
            size = math.sqrt(n[h, 0] ** 2 + n[h, 1] ** 2 + n[h, 2] ** 2)
            scale = 1 / size if size > _CANCELLED else 0.0
            for c in range(3):
                n[h, c] *= scale


@kernel
def fit_range(normals, vertex, indices, weights, transforms, gram, right, first, last):
    """Add up Aᵀ A and Aᵀ n over all frames, where A is the blended matrix at a normal n.

    normals     (F, N, 3)     float64  normals to reproduce, 0 where they are unknown, in
    vertex      (N,)          int32    vertex of each normal, in
    indices     (V, K)        int32    bone of each influence, in
    weights     (V, K)        float64  its weight, 0 in unused influences, in
    transforms  (F, B, 3, 4)  float64  bones, in
    gram        (N, 6)        float64  upper triangles of the sums of Aᵀ A, added to for normals
                                       first..last
    right       (N, 3)        float64  sums of Aᵀ n, added to for normals first..last
    """
    n_slots = indices.shape[1]
    for t in range(len(normals)):
        m = transforms[t].reshape(-1)
        for h in range(first, last):
            x, y, z = normals[t, h, 0], normals[t, h, 1], normals[t, h, 2]
            if x == 0 and y == 0 and z == 0:
                continue
            i = vertex[h]
            a = b = c = d = e = f = g = o = q = 0.0
            for k in range(n_slots):
                w = weights[i, k]
                if w == 0:  # unused influences name bone 0, whose transform may not be finite
                    continue
                s = indices[i, k] * 12
                a += w * m[s]
                b += w * m[s + 1]
                c += w * m[s + 2]
                d += w * m[s + 4]
                e += w * m[s + 5]
                f += w * m[s + 6]
                g += w * m[s + 8]
                o += w * m[s + 9]
                q += w * m[s + 10]
            gram[h, 0] += a * a + d * d + g * g
            gram[h, 1] += a * b + d * e + g * o
            gram[h, 2] += a * c + d * f + g * q
            gram[h, 3] += b * b + e * e + o * o
            gram[h, 4] += b * c + e * f + o * q
            gram[h, 5] += c * c + f * f + q * q
            right[h, 0] += a * x + d * y + g * z
            right[h, 1] += b * x + e * y + o * z
            right[h, 2] += c * x + f * y + q * z


@kernel
def angles_range(normals, drawn, out, first, last):
    """Compute the angles between two sets of normals in frames first..last.

    normals  (F, N, 3)  float64  unit normals, 0 where they are unknown, in
    drawn    (F, N, 3)  float64  vectors of any norm, in
    out      (F, N)     float64  angles in degrees, written for frames first..last: -1 where the
                                 normal is unknown, 90 where the vector is 0
    """
    for t in range(first, last):
        for h in range(normals.shape[1]):
            x, y, z = normals[t, h, 0], normals[t, h, 1], normals[t, h, 2]
            a, b, c = drawn[t, h, 0], drawn[t, h, 1], drawn[t, h, 2]
            across = math.sqrt((y * c - z * b) ** 2 + (z * a - x * c) ** 2 + (x * b - y * a) ** 2)
            along = x * a + y * b + z * c
            if x == 0 and y == 0 and z == 0:
                out[t, h] = -1.0
            elif across == 0 and along == 0:
                out[t, h] = 90.0
            else:
                out[t, h] = math.degrees(math.atan2(across, along))
