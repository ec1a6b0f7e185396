"""The body's joints and skin between two frames."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .policy import kernel

__all__ = ["pose_joints", "skin_points"]


@kernel
def pose_joints(
    parents: Any, rest: Any, root: Any, local: Any, turn: Any, fraction: float, out: Any
) -> None:
    """World transforms from the rest pose, at a fraction of the way to the next frame.

    Each rotation relative to the parent is followed by its rotation vector times the fraction
    (slerp); a parent comes before its children.

    parents  (J,)       int32    -1 for the root
    rest     (J, 3)     float64  joints at rest
    root     (3,)       float64  place of the root
    local    (J, 3, 3)  float64  rotations relative to the parent, in the frame before
    turn     (J, 3)     float64  rotation vectors to the next frame
    out      (J, 12)    float32  rows of the 3 × 4 matrices
    """
    n = len(parents)
    heads, world = np.empty((n, 3)), np.empty((n, 3, 3))
    step, turned = np.empty((3, 3)), np.empty((3, 3))
    for j in range(n):
        x, y, z = fraction * turn[j, 0], fraction * turn[j, 1], fraction * turn[j, 2]
        square = x * x + y * y + z * z
        # Rodrigues' formula; its series where the angle is small.
        a, b = 1.0 - square / 6, 0.5 - square / 24
        if square > 1e-12:
            angle = math.sqrt(square)
            a, b = math.sin(angle) / angle, (1 - math.cos(angle)) / square
        step[0, 0], step[0, 1], step[0, 2] = (
            1 - b * (y * y + z * z),
            b * x * y - a * z,
            b * x * z + a * y,
        )
        step[1, 0], step[1, 1], step[1, 2] = (
            b * x * y + a * z,
            1 - b * (x * x + z * z),
            b * y * z - a * x,
        )
        step[2, 0], step[2, 1], step[2, 2] = (
            b * x * z - a * y,
            b * y * z + a * x,
            1 - b * (x * x + y * y),
        )
        parent = parents[j]
        for r in range(3):
            for k in range(3):
                turned[r, k] = 0.0
                for q in range(3):
                    turned[r, k] += local[j, r, q] * step[q, k]
        for r in range(3):
            heads[j, r] = root[r] if parent < 0 else heads[parent, r]
            for k in range(3):
                world[j, r, k] = turned[r, k]
                if parent >= 0:
                    heads[j, r] += world[parent, r, k] * (rest[j, k] - rest[parent, k])
                    world[j, r, k] = 0.0
                    for q in range(3):
                        world[j, r, k] += world[parent, r, q] * turned[q, k]
            shift = heads[j, r]
            for k in range(3):
                shift -= world[j, r, k] * rest[j, k]
                out[j, 4 * r + k] = world[j, r, k]
            out[j, 4 * r + 3] = shift


@kernel
def skin_points(skin: Any, transforms: Any, out: Any) -> None:
    """Linear blend skinning of points.

    skin        tuple     rest (n, 3) float32, indices (n, K) int32, weights (n, K) float32
    transforms  (J, 12)   float32
    out         (3 n,)    float32
    """
    rest, indices, weights = skin
    blend = np.empty(12, transforms.dtype)
    for i in range(len(rest)):
        blend[:] = 0
        for q in range(indices.shape[1]):
            w, j = weights[i, q], indices[i, q]
            for k in range(12):
                blend[k] += w * transforms[j, k]
        x, y, z = rest[i, 0], rest[i, 1], rest[i, 2]
        for r in range(3):
            out[3 * i + r] = (
                blend[4 * r] * x + blend[4 * r + 1] * y + blend[4 * r + 2] * z + blend[4 * r + 3]
            )
