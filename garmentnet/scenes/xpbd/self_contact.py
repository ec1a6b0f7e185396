"""Contact of the cloth with itself: vertices keep a distance from each other."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .policy import REAL, TINY, kernel

__all__ = ["find_pairs", "separate"]

# Number of cells of the hash table; a power of 2.
_CELLS = 4096
# Distance within which pairs are kept, as a multiple of the thickness.
_MARGIN = REAL(2.5)
# Part of the overlap that is removed in a substep.
_PART = REAL(0.5)


@kernel
def _cell(a: int, b: int, c: int) -> int:
    return ((a * 73856093) ^ (b * 19349663) ^ (c * 83492791)) & (_CELLS - 1)


@kernel
def find_pairs(x: Any, weights: Any, near: Any, starts: Any, thickness: Any, pairs: Any) -> int:
    """Find pairs of vertices that may come within `thickness`, and return their number.

    At most as many are found as `pairs` can hold.  A hash grid with cells as large as the distance
    within which pairs are kept is filled vertex by vertex (Teschner et al., "Optimized
    Spatial Hashing for Collision Detection of Deformable Objects", VMV 2003).

    weights       (V,)    float32  inverse masses; two that are 0 make no pair
    near, starts  CSR     int32    vertices within two edges of each vertex, which make no pair
    pairs         (n, 2)  int32    out
    """
    head, after = np.full(_CELLS, -1, np.int32), np.full(len(x) // 3, -1, np.int32)
    reach = _MARGIN * thickness
    inverse, square, count = REAL(1) / reach, reach * reach, 0
    for i in range(len(weights)):
        px, py, pz = x[3 * i], x[3 * i + 1], x[3 * i + 2]
        a, b, c = math.floor(px * inverse), math.floor(py * inverse), math.floor(pz * inverse)
        for da in range(-1, 2):
            for db in range(-1, 2):
                for dc in range(-1, 2):
                    j = head[_cell(a + da, b + db, c + dc)]
                    while j >= 0:
                        dx, dy, dz = px - x[3 * j], py - x[3 * j + 1], pz - x[3 * j + 2]
                        # Several cells may share an entry of the table: compare the cell, too.
                        same = (
                            math.floor(x[3 * j] * inverse) == a + da
                            and math.floor(x[3 * j + 1] * inverse) == b + db
                            and math.floor(x[3 * j + 2] * inverse) == c + dc
                        )
                        if same and dx * dx + dy * dy + dz * dz < square and count < len(pairs):
                            known = weights[i] + weights[j] == 0
                            for k in range(starts[i], starts[i + 1]):
                                known = known or near[k] == j
                            if not known:
                                pairs[count, 0], pairs[count, 1] = i, j
                                count += 1
                        j = after[j]
        place = _cell(a, b, c)
        after[i], head[place] = head[place], i
    return count


@kernel
def separate(x: Any, weights: Any, pairs: Any, count: int, thickness: Any) -> None:
    """Push pairs of vertices apart, half-way towards C = |xᵢ − xⱼ| − thickness ≥ 0.

    weights  (V,)  float32  inverse masses
    """
    for n in range(count):
        i, j = 3 * pairs[n, 0], 3 * pairs[n, 1]
        dx, dy, dz = x[i] - x[j], x[i + 1] - x[j + 1], x[i + 2] - x[j + 2]
        square = dx * dx + dy * dy + dz * dz
        if square >= thickness * thickness:
            continue
        length = math.sqrt(square + TINY)
        w1, w2 = weights[pairs[n, 0]], weights[pairs[n, 1]]
        push = _PART * (thickness - length) / (length * (w1 + w2))
        x[i] += push * w1 * dx
        x[i + 1] += push * w1 * dy
        x[i + 2] += push * w1 * dz
        x[j] -= push * w2 * dx
        x[j + 1] -= push * w2 * dy
        x[j + 2] -= push * w2 * dz
