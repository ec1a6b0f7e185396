"""Bytes of a model."""

from __future__ import annotations

import numpy as np

import ssdr
from ssdr import parsimony


def test_size_by_hand() -> None:
    indices = np.array([[0, 1], [1, 0], [2, 0]])
    weights = np.array([[0.5, 0.5], [1.0, 0.0], [1.0, 0.0]])
    keys = np.zeros((5, 3), dtype=bool)
    keys[:, 0] = True  # every frame: no times
    keys[[0, 4], 1] = True
    keys[0, 2] = True
    model = ssdr.Skinning(
        np.zeros((3, 3)), indices, weights, np.tile(np.eye(4)[:3], (5, 3, 1, 1)), keyframes=keys
    )
    size = parsimony.size(model)
    assert size == parsimony.Size(
        rest=3 * 12, weights=3 * 1 + 4 * 3, joints=3 * 12, keys=5 * 28 + 2 * 30 + 30
    )
    assert size.total == 36 + 15 + 36 + 230
    whole = ssdr.Skinning(
        np.zeros((1, 3)),
        [[0]],
        [[1.0]],
        np.tile(np.eye(4)[:3], (2, 300, 1, 1)),
        bone_model="affine",
    )
    assert parsimony.size(whole).total == 12 + (1 + 4) + 300 * 12 + 2 * 300 * 56
