"""A sweep over the bones of each frame, against one in NumPy."""

from __future__ import annotations

import numpy as np

from helpers import motions
from ssdr.kernels.bones import sweep_bones


def test_a_sweep_fits_one_bone_after_the_other(rng: np.random.Generator) -> None:
    frames, bones, vertices = 4, 5, 40
    rest, truth = rng.standard_normal((vertices, 3)), motions.motions(rng, frames, bones)
    indices, weights = motions.weights_of(rng, vertices, bones, 3)
    dense = np.zeros((vertices, bones))
    np.put_along_axis(dense, indices, weights, axis=1)
    moved = motions.blend(rest, indices, weights, truth)
    moved += 0.1 * rng.standard_normal(moved.shape)
    a = dense[:, :, None] * np.append(rest, np.ones((vertices, 1)), axis=1)[:, None]
    u = np.einsum("vjd,vke->jkde", a, a)
    c = np.einsum("tva,vjd->tadj", moved, a)
    found = motions.motions(rng, frames, bones)
    want = found.copy()
    shared = (u[:, :, 3, 3] != 0) & ~np.eye(bones, dtype=bool)
    start = np.append(0, np.cumsum(shared.sum(axis=1))).astype(np.int32)
    neighbour = np.nonzero(shared)[1].astype(np.int32)
    sweep_bones(found, np.ascontiguousarray(c), u, start, neighbour, False, 2)
    for m, target in zip(want, c, strict=True):
        for j in 2 * [*range(bones)]:
            left = target[..., j] - sum(m[k] @ u[k, j] for k in range(bones) if k != j)
            own, mass = u[j, j], u[j, j, 3, 3]
            x, _, y = np.linalg.svd(left[:, :3] - np.outer(left[:, 3], own[3, :3]) / mass)
            m[j, :, :3] = x @ np.diag([1, 1, np.linalg.det(x @ y)]) @ y
            m[j, :, 3] = (left[:, 3] - m[j, :, :3] @ own[:3, 3]) / mass
    np.testing.assert_allclose(found, want, atol=1e-9)
