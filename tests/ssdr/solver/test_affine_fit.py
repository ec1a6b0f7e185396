"""Affine bones where data leave them open or turn them inside out."""

from __future__ import annotations

import numpy as np

import ssdr
from helpers import motions
from ssdr.solver.affine_fit import solve_affine
from ssdr.solver.model import Model
from ssdr.solver.moments import bone_sums
from ssdr.solver.trajectories import gather


def test_what_a_plane_leaves_open_stays_rigid() -> None:
    """The direction across flat patches is that of the rigid fit: of length 1, upright."""
    rng = np.random.default_rng(1)
    rest = np.concatenate([rng.standard_normal((30, 2)), np.zeros((30, 1))], axis=1)
    indices = np.repeat([[0], [1]], 15, axis=0)
    truth = motions.motions(rng, 6, 2)
    truth[..., 0] *= 1.5
    frames = motions.blend(rest, indices, np.ones((30, 1)), truth)
    model = ssdr.Skinning(rest, indices, np.ones((30, 1)), truth, bone_model="affine")
    fit = ssdr.fit_bones(frames, model)
    assert fit.rmse < 1e-6
    np.testing.assert_allclose(fit.skinning.transforms[..., :2], truth[..., :2], atol=1e-5)
    across = fit.skinning.transforms[..., 2]
    assert 0.5 < np.linalg.norm(across, axis=-1).min() <= np.linalg.norm(across, axis=-1).max() < 2
    assert (np.einsum("tja,tja->tj", across, truth[..., 2]) > 0).all()


def test_bones_that_data_turn_inside_out_stop_before_and_still_descend() -> None:
    rng = np.random.default_rng(2)
    rest = rng.standard_normal((40, 3))
    indices, weights = motions.weights_of(rng, 40, 3, 2)
    frames = motions.blend(rest, indices, weights, motions.motions(rng, 6, 3))
    frames[2:] *= np.array([1, 1, -1])
    data = gather([ssdr.MeshSequence(frames)], bones=3)
    inner, m = data.from_world(rest, np.tile(np.eye(4)[:3], (6, 3, 1, 1)))
    assert m is not None
    u, c = bone_sums(data, Model.with_weights(m, inner, indices, weights, 2))
    free = np.zeros(3, dtype=bool)
    goal = np.stack([data.frame(t) for t in range(6)])
    values = []
    for _ in range(6):
        solve_affine(m, u, c, free)
        assert (np.linalg.det(m[..., :3]) > 0).all()
        values.append(((motions.blend(inner, indices, weights, m) - goal) ** 2).sum())
    assert (np.diff(values) <= 1e-9 * values[0]).all()
    assert np.linalg.det(m[..., :3]).min() < 0.05  # it did come to the border
