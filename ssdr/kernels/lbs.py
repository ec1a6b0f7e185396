"""Kernels of linear blend skinning: positions, their squared errors, and their derivatives."""

from __future__ import annotations

import numpy as np

from .policy import kernel


@kernel
def skin_range(rest, indices, weights, transforms, out, first, last):
    """Compute the positions of vertices first..last in every frame by linear blend skinning.

    rest        (V, 3)        float     rest positions, in
    indices     (V, K)        int32     bone of each influence, in
    weights     (V, K)        float     its weight, 0 in unused influences, in
    transforms  (F, B, 3, 4)  float     transforms of the bones, in
    out         (F, V, 3)     float     positions, written for first..last

    ``float`` is float32 or float64, the same type for all four arrays.
    """
    n_slots = indices.shape[1]
    for t in range(transforms.shape[0]):
        # Blending the twelve entries by flat index is a quarter faster than blending points.  The
        # sums start from a typed zero: a plain one would make them float64.
        m = transforms[t].reshape(-1)
        for i in range(first, last):
            zero = rest.dtype.type(0)
            a = b = c = d = e = f = g = h = o = p = q = r = zero
            for k in range(n_slots):
                w = weights[i, k]
                if w == 0:  # unused influences name bone 0, whose transform may not be finite
                    continue
                s = indices[i, k] * 12
                a += w * m[s]
                b += w * m[s + 1]
                c += w * m[s + 2]
                d += w * m[s + 3]
                e += w * m[s + 4]
                f += w * m[s + 5]
                g += w * m[s + 6]
                h += w * m[s + 7]
                o += w * m[s + 8]
                p += w * m[s + 9]
                q += w * m[s + 10]
                r += w * m[s + 11]
            x, y, z = rest[i, 0], rest[i, 1], rest[i, 2]
            out[t, i, 0] = a * x + b * y + c * z + d
            out[t, i, 1] = e * x + f * y + g * z + h
            out[t, i, 2] = o * x + p * y + q * z + r


@kernel
def squared_error_range(rest, indices, weights, transforms, target, first, last, per_vertex):
    """Add up each vertex's squared distance from its target positions over all frames.

    rest        (V, 3)        float64   rest positions, in
    indices     (V, K)        int32     bone of each influence, in
    weights     (V, K)        float64   its weight, 0 in unused influences, in
    transforms  (F, B, 3, 4)  float64   bones, in
    target      (F, V, 3)     float     positions to reproduce, float32 or float64, in
    per_vertex  (V,)          float64   sums of squared distances; those of first..last are added to
    """
    n_slots = indices.shape[1]
    for t in range(transforms.shape[0]):
        for i in range(first, last):
            x, y, z = rest[i, 0], rest[i, 1], rest[i, 2]
            a = -np.float64(target[t, i, 0])
            b = -np.float64(target[t, i, 1])
            c = -np.float64(target[t, i, 2])
            for k in range(n_slots):
                w = weights[i, k]
                if w == 0:  # unused influences name bone 0, whose transform may not be finite
                    continue
                m = transforms[t, indices[i, k]]
                a += w * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3])
                b += w * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3])
                c += w * (m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3])
            per_vertex[i] += a * a + b * b + c * c


@kernel
def pull_back_to_vertices(
    rest, indices, weights, transforms, gradient, to_rest, to_weights, first, last
):
    """Add up the gradients with respect to rest positions and weights of vertices first..last.

    rest        (V, 3)        float     rest positions, in
    indices     (V, K)        int32     bone of each influence, in
    weights     (V, K)        float     its weight, in
    transforms  (F, B, 3, 4)  float     transforms of the bones, in
    gradient    (F, V, 3)     float     gradient with respect to the positions, in
    to_rest     (V, 3)        float64   gradient with respect to `rest`, added to first..last
    to_weights  (V, K)        float64   gradient with respect to `weights`, added to first..last

    ``float`` is float32 or float64, the same type for all five arrays.
    """
    for t in range(transforms.shape[0]):
        for i in range(first, last):
            x, y, z = np.float64(rest[i, 0]), np.float64(rest[i, 1]), np.float64(rest[i, 2])
            gx = np.float64(gradient[t, i, 0])
            gy = np.float64(gradient[t, i, 1])
            gz = np.float64(gradient[t, i, 2])
            for k in range(indices.shape[1]):
                m = transforms[t, indices[i, k]]
                a = gx * m[0, 0] + gy * m[1, 0] + gz * m[2, 0]
                b = gx * m[0, 1] + gy * m[1, 1] + gz * m[2, 1]
                c = gx * m[0, 2] + gy * m[1, 2] + gz * m[2, 2]
                d = gx * m[0, 3] + gy * m[1, 3] + gz * m[2, 3]
                to_weights[i, k] += a * x + b * y + c * z + d
                w = weights[i, k]
                if w != 0:  # unused influences name bone 0, whose transform may not be finite
                    to_rest[i, 0] += w * a
                    to_rest[i, 1] += w * b
                    to_rest[i, 2] += w * c


@kernel
def pull_back_to_bones(rest, indices, weights, gradient, to_transforms, first, last):
    """Add up the gradients with respect to the transforms of frames first..last.

    rest           (V, 3)        float     rest positions, in
    indices        (V, K)        int32     bone of each influence, in
    weights        (V, K)        float     its weight, 0 in unused influences, in
    gradient       (F, V, 3)     float     gradient with respect to the positions, in
    to_transforms  (F, B, 3, 4)  float64   gradient with respect to the transforms, added to
                                           first..last

    ``float`` is float32 or float64, the same type for all four arrays.
    """
    for t in range(first, last):
        for i in range(rest.shape[0]):
            x, y, z = np.float64(rest[i, 0]), np.float64(rest[i, 1]), np.float64(rest[i, 2])
            for k in range(indices.shape[1]):
                w = np.float64(weights[i, k])
                if w == 0:
                    continue
                out = to_transforms[t, indices[i, k]]
                for c in range(3):
                    g = w * gradient[t, i, c]
                    out[c, 0] += g * x
                    out[c, 1] += g * y
                    out[c, 2] += g * z
                    out[c, 3] += g
