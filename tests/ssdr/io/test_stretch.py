"""Bones that stretch play as two nodes of rotations and scales."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

import ssdr
from helpers.rig_model import largest_distance, tube
from helpers.rig_tree import stretched
from ssdr.io.played_model import as_played
from ssdr.model.keyframes import Tracks
from ssdr.model.stretch import steady_axes


def test_axes_are_exact_and_steady():
    matrices = stretched(tube(frames=60)).transforms[..., :3]
    u, s, vt = steady_axes(matrices)
    np.testing.assert_allclose((u * s[..., None, :]) @ vt, matrices, atol=1e-12)
    for turn in (u, vt):
        np.testing.assert_allclose(np.linalg.det(turn), 1, atol=1e-12)
    # where axes turn by 2° a frame and sizes cross each other, no axis takes another's place
    step = np.degrees(
        Rotation.from_matrix((vt[1:] @ vt[:-1].swapaxes(2, 3)).reshape(-1, 3, 3)).magnitude()
    )
    assert np.quantile(step, 0.95) < 5


def test_a_bone_that_turns_and_stretches_is_right_between_frames():
    """Along one axis: the mean of the matrices but for the arc of the turn."""
    angle, size = np.linspace(0, 0.5, 11), np.linspace(1, 2, 11)
    turn = Rotation.from_rotvec(angle[:, None] * [0, 0, 1]).as_matrix()
    axis = Rotation.from_euler("xyz", [0.3, 0.5, 0.2]).as_matrix()
    matrices = turn @ (axis * np.stack([size, np.ones(11), np.ones(11)], axis=1)[:, None]) @ axis.T
    moves = np.concatenate([matrices, np.zeros((11, 3, 1))], axis=2)[:, None]
    rest = np.random.default_rng(0).normal(size=(9, 3))
    model = ssdr.Skinning.from_dense(rest, np.ones((9, 1)), moves, bone_model="affine")
    rig = as_played(model, stretch=True)
    half = rig.matrices(np.array([4.5]))[0, rig.moving[0], :, :3]
    middle = Rotation.from_rotvec([0, 0, 0.225]).as_matrix()
    expected = middle @ (axis * np.array([1.45, 1, 1])) @ axis.T
    np.testing.assert_allclose(half, expected, atol=1e-6)
    assert rig.error(model)[1] < 1e-6


def test_keys_that_are_left_out_play_in_a_file_as_in_the_model(tmp_path):
    model = stretched(tube())
    tracks = Tracks(model, np.array([0, model.n_frames]))
    kept = tracks.play(tracks.choose(5e-3)[0])
    assert kept.keyframes.mean() < 0.7
    assert 0.01 < largest_distance(kept.skin(), model.skin()) < 0.1
    assert ssdr.save(kept, tmp_path / "a.glb").max_error < 1e-5
