"""Body and cloth as one mesh, the camera's path, and what is written beside them."""

import numpy as np
import pytest

from garmentnet.drawing.dressed import (
    camera_track,
    dressed,
    error_text,
    facing_the_camera,
    outfit_look,
)
from ssdr.show.subject import Scene


def test_the_exact_body_and_pinned_vertices_are_not_in_the_figures(toy_store):
    # The body is exact and the cloth is off by 30 mm where it is free: so the error is 30 mm.
    clip = toy_store.clip("base-test-0")
    body, cloth = clip.body(slice(0, 3)), np.asarray(clip.sequence.frames(slice(0, 3)))
    faces = toy_store.body.faces, toy_store.faces
    n, v = toy_store.body.n_vertices, toy_store.n_vertices
    moved = cloth + np.float32([0, 0.03, 0])
    truth, off = (dressed(body, x, *faces, 30.0) for x in (cloth, moved))
    assert Scene.of(off, truth, **outfit_look(n, v)).distances.rmse == pytest.approx(0.03, rel=1e-5)
    assert truth.faces.max() == n + v - 1
    assert error_text(cloth, moved, toy_store) == "all 30.0 mm"


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
