"""Affine bones where data leave them open or turn them inside out, and leaps of rigid ones."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

import ssdr
from helpers import motions
from ssdr.solver.affine_fit import leap_rigid, solve_affine
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
    inner, m = motions.in_solver(data, rest, np.tile(np.eye(4)[:3], (6, 3, 1, 1)))
    assert m is not None
    u, c = bone_sums(data, Model.with_weights(m, inner, indices, weights, 2))
    goal = np.stack([data.frame(t) for t in range(6)])
    values = []
    for _ in range(6):
        solve_affine(m, u, c)
        assert (np.linalg.det(m[..., :3]) > 0).all()
        values.append(((motions.blend(inner, indices, weights, m) - goal) ** 2).sum())
    assert (np.diff(values) <= 1e-9 * values[0]).all()
    assert np.linalg.det(m[..., :3]).min() < 0.05  # it did come to the border


def test_a_leap_is_a_step_of_gauss_newton_about_the_centres_of_the_bones() -> None:
    rng = np.random.default_rng(3)
    rest = rng.standard_normal((60, 3))
    indices, weights = motions.weights_of(rng, 60, 4, 3)
    truth = np.tile(motions.motions(rng, 1, 4), (2, 1, 1, 1))
    frames = motions.blend(rest, indices, weights, truth)
    data = gather([ssdr.MeshSequence(frames)], bones=4, compress=False)
    rest, exact = motions.in_solver(data, rest, truth)
    far = np.concatenate([np.full((1, 12), 0.1), np.full((1, 12), 1.5)])
    start = exact.copy()
    turns = Rotation.from_rotvec((far * rng.standard_normal(12)).reshape(-1, 3)).as_matrix()
    start[..., :3] = start[..., :3] @ turns.reshape(2, 4, 3, 3)
    start[1, 0] = start[0, 0]
    model = Model.with_weights(start.copy(), rest, indices, weights, 3)
    u, c = bone_sums(data, model)
    leap_rigid(model.transforms, u, c)

    own = u[np.arange(4), np.arange(4)]
    centre = own[:, :3, 3] / own[:, 3:, 3]

    def moved(x: np.ndarray) -> np.ndarray:
        turn, shift = np.split(x.reshape(4, 6), 2, axis=1)
        out = start[0].copy()
        quaternions = np.concatenate([turn / 2, np.ones((4, 1))], axis=1)
        out[..., :3] = out[..., :3] @ Rotation.from_quat(quaternions).as_matrix()
        place = np.einsum("jab,jb->ja", start[0, :, :, :3], centre + shift) + start[0, :, :, 3]
        out[..., 3] = place - np.einsum("jab,jb->ja", out[..., :3], centre)
        return out

    def residual(x: np.ndarray) -> np.ndarray:
        return (motions.blend(rest, indices, weights, moved(x)[None])[0] - data.frame(0)).ravel()

    step = 1e-5
    jacobian = np.stack(
        [(residual(step * e) - residual(-step * e)) / (2 * step) for e in np.eye(24)], axis=1
    )
    # damped by 1e-3 of what a bone by itself would have on the diagonal
    offset = rest - centre[:, None]
    dense = model.dense_weights().T
    spread = np.einsum("ji,jic,jic->jc", dense**2, offset, offset)
    turned = spread.sum(axis=1, keepdims=True) - spread
    diagonal = np.concatenate([turned, np.tile((dense**2).sum(1)[:, None], 3)], axis=1).ravel()
    matrix = jacobian.T @ jacobian + 1e-3 * np.diag(diagonal)
    x = -np.linalg.solve(matrix, jacobian.T @ residual(np.zeros(24)))
    np.testing.assert_allclose(model.transforms[0], moved(x), atol=1e-5)
    # the second frame is the same, and begins too far off, so that it goes on from the first
    before, after = (
        np.linalg.norm(motions.blend(rest, indices, weights, m)[t] - data.frame(t))
        for m, t in ((start, 1), (model.transforms, 1))
    )
    assert after < np.linalg.norm(residual(x)) < 0.5 * before
