"""Body and cloth as one mesh, the camera's path, and what is written beside them."""

import numpy as np

from garmentnet.drawing.dressed import (
    camera_track,
    facing_the_camera,
)


def test_the_camera_walks_smoothly_and_stays_level():
    time = np.arange(90) / 30
    step = np.sin(12 * time)
    root = np.stack([2 * time + 0.02 * step, 1 + 0.3 * step, -time], axis=1)
    path = camera_track(root, 30.0)
    assert (path[:, 1] == 0).all()
    assert np.abs(path - root * [1, 0, 1])[30:60].max() < 0.03
    assert np.abs(np.diff(path[30:60, 0], 2)).max() < 0.3 * np.abs(np.diff(root[30:60, 0], 2)).max()


def test_every_pose_faces_the_camera_at_one_place(toy_store):
    clip = toy_store.clip("base-test-0")
    frames = slice(0, 90, 15)
    joints, body = clip.joints[frames], clip.body(frames)
    places = toy_store.skeleton.positions(joints)
    turned = facing_the_camera(body, places[:, 0], joints)
    root = facing_the_camera(places, places[:, 0], joints)[:, 0]
    assert np.abs(root[:, [0, 2]]).max() < 1e-6
    # Rigid, and level: heights stay.
    np.testing.assert_allclose(turned[..., 1], body[..., 1], atol=1e-6)
    lengths = [np.linalg.norm(v[:, 1:] - v[:, :1], axis=2) for v in (turned, body)]
    np.testing.assert_allclose(*lengths, atol=1e-5)
    forward = joints[:, 0, :, 2] + places[:, 0]
    ahead = facing_the_camera(forward[:, None], places[:, 0], joints)[:, 0]
    assert np.abs(ahead[:, 0]).max() < 1e-5
    assert (ahead[:, 2] > 0).all()


def test_a_body_that_looks_up_is_not_turned():
    joints = np.tile(np.eye(3, 4), (1, 3, 1, 1))
    joints[0, :, :, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    at = np.array([[[0.3, 1.0, 0.2]]])
    beside = facing_the_camera(at + np.array([1, 0, 0]), at[:, 0], joints)
    np.testing.assert_allclose(beside, [[[1, 1, 0]]], atol=1e-6)
