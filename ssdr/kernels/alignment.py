"""Kernel that transforms frames to the solver's coordinates."""

from __future__ import annotations

from typing import Any

from .policy import kernel


@kernel
def inward_range(
    block: Any, centre: Any, rotation: Any, factor: Any, out: Any, first: int, last: int
) -> None:
    """Rotate and scale frames about their centres, for vertices first..last.

    block     (F, V, 3)  real     positions, in
    centre    (F, 3)     float64  origin of each frame, in
    rotation  (F, 3, 3)  float64  axes of each frame, in columns, in
    factor    (F,)       float64  scale of each frame, in
    out       (V, F, 3)  float64  coordinates along the axes, written for vertices first..last
    """
    for t in range(len(block)):
        r, s = rotation[t], factor[t]
        a, b, c = r[0, 0] * s, r[0, 1] * s, r[0, 2] * s
        d, e, f = r[1, 0] * s, r[1, 1] * s, r[1, 2] * s
        g, h, k = r[2, 0] * s, r[2, 1] * s, r[2, 2] * s
        u, v, w = centre[t, 0], centre[t, 1], centre[t, 2]
        for i in range(first, last):
            x, y, z = block[t, i, 0] - u, block[t, i, 1] - v, block[t, i, 2] - w
            out[i, t, 0] = x * a + y * d + z * g
            out[i, t, 1] = x * b + y * e + z * h
            out[i, t, 2] = x * c + y * f + z * k
