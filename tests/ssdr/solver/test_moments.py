"""Sums over vertices of which the bones are computed."""

from __future__ import annotations

import numpy as np

import ssdr
from helpers import motions
from ssdr.solver.model import Model
from ssdr.solver.moments import bone_sums
from ssdr.solver.trajectories import gather


def test_sums_against_loops(rng: np.random.Generator) -> None:
    n, bones, n_frames = 15, 4, 3
    frames = rng.standard_normal((n_frames, n, 3))
    indices, weights = motions.weights_of(rng, n, bones, 3)
    importance, frame_importance = rng.random(n), 0.5 + rng.random(n_frames)
    data = gather(
        [ssdr.MeshSequence(frames)],
        bones=40,
        vertex_importance=importance,
        frame_importance=frame_importance,
    )
    rest = rng.standard_normal((n, 3))
    still = np.broadcast_to(np.eye(3, 4), (n_frames, bones, 3, 4))
    u, c = bone_sums(data, Model.with_weights(still, rest, indices, weights, 3))
    want_u, want_c = np.zeros((bones, bones, 4, 4)), np.zeros((n_frames, 3, 4, bones))
    inner = np.stack([data.frame(t) for t in range(n_frames)])
    mean_one = importance / importance.mean()
    for i in range(n):
        p = np.append(rest[i], 1.0)
        for j, w in zip(indices[i], weights[i], strict=True):
            for k, v in zip(indices[i], weights[i], strict=True):
                want_u[j, k] += mean_one[i] * w * v * np.outer(p, p)
            for t in range(n_frames):
                want_c[t, :, :, j] += mean_one[i] * w * np.outer(inner[t, i], p)
    np.testing.assert_allclose(u, want_u, atol=1e-12)
    np.testing.assert_allclose(c, want_c, atol=1e-12)
