"""Forward linear blend skinning."""

from __future__ import annotations

import numpy as np

from .policy import kernel


@kernel
def skin_range(rest, joints, weights, transforms, out, first, last):
    """Write frames ``out (f,V,3)`` of vertices first..last; transforms ``(f,B,3,4)``."""
    n_slots = joints.shape[1]
    for t in range(transforms.shape[0]):
        for i in range(first, last):
            x, y, z = rest[i, 0], rest[i, 1], rest[i, 2]
            a = b = c = x * 0
            for k in range(n_slots):
                w = weights[i, k]
                if w == 0:
                    continue
                m = transforms[t, joints[i, k]]
                a += w * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3])
                b += w * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3])
                c += w * (m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3])
            out[t, i, 0] = a
            out[t, i, 1] = b
            out[t, i, 2] = c


@kernel
def squared_error_range(rest, joints, weights, transforms, target, first, last, per_vertex):
    """Add each vertex's squared distance over the frames ``target (f,V,3)`` to `per_vertex`."""
    n_slots = joints.shape[1]
    for t in range(transforms.shape[0]):
        for i in range(first, last):
            x, y, z = rest[i, 0], rest[i, 1], rest[i, 2]
            a = -np.float64(target[t, i, 0])
            b = -np.float64(target[t, i, 1])
            c = -np.float64(target[t, i, 2])
            for k in range(n_slots):
                w = weights[i, k]
                if w == 0:
                    continue
                m = transforms[t, joints[i, k]]
                a += w * (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3])
                b += w * (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3])
                c += w * (m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3])
            per_vertex[i] += a * a + b * b + c * c
