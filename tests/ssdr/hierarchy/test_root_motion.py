"""A root joint that carries the ground track and heading of a model."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ssdr
from helpers.rig_tree import creature, flat
from ssdr.hierarchy.root_motion import ground_motion, with_root
from ssdr.hierarchy.transforms import from_local


def moved(model, motion):
    """The same bones, all of them moved by the rigid motion (F, 3, 4)."""
    turn, shift = motion[:, None, :, :3], motion[:, None, :, 3]
    m = model.transforms
    at = (turn @ m[..., 3:])[..., 0] + shift
    return dataclasses.replace(
        model, transforms=np.concatenate([turn @ m[..., :3], at[..., None]], axis=-1)
    )


def path(up, frames=10):
    """A track on the ground that turns by more than a full circle."""
    angle = np.linspace(0.3, 9.0, frames)
    axis = np.eye(3)["xyz".index(up)]
    motion = np.zeros((frames, 3, 4))
    motion[..., :3] = Rotation.from_rotvec(angle[:, None] * axis).as_matrix()
    motion[..., 3] = np.stack([np.cos(angle), 0.3 * angle, angle**2], axis=1) * (1 - axis)
    return motion


def naive(model):
    """Planar fit of the skinned vertices of each frame, as complex numbers on the ground."""
    plane = [0, 1] if model.space.up == "z" else [2, 0]
    rest = model.rest[:, plane] @ [1, 1j]
    found = []
    for points in model.skin(dtype=float):
        p = points[:, plane] @ [1, 1j]
        turn = np.vdot(rest - rest.mean(), p - p.mean())
        turn /= abs(turn)
        found.append((turn, p.mean() - turn * rest.mean()))
    return np.array(found).T


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("tree", [True, False])
def test_a_walk_that_moves_and_turns_is_in_place_below_its_root(up, tree):
    model = creature(loose=True) if tree else flat(creature())
    model = dataclasses.replace(model, space=ssdr.Space(1.0, up))
    # A walk in place, by the naive fit; then the same walk along a path.
    turn, shift = naive(model)
    plane = [0, 1] if up == "z" else [2, 0]
    back = np.tile(np.eye(3, 4), (model.n_frames, 1, 1))
    angle = -np.angle(turn)[:, None] * np.eye(3)["xyz".index(up)]
    back[..., :3] = Rotation.from_rotvec(angle).as_matrix()
    away = -shift / turn
    back[:, plane, 3] = np.stack([away.real, away.imag], axis=1)
    in_place, track = moved(model, back), path(up)
    walk = moved(in_place, track)

    np.testing.assert_allclose(ground_motion(in_place), path(up) * 0 + np.eye(3, 4), atol=1e-9)
    np.testing.assert_allclose(ground_motion(walk), track, atol=1e-9)
    rooted, still = with_root(walk), with_root(in_place)
    root = rooted.n_bones - 1
    np.testing.assert_allclose(rooted.transforms[:, root], track, atol=1e-9)
    local = rooted.local_transforms()
    np.testing.assert_allclose(local[:, :root], still.local_transforms()[:, :root], atol=1e-9)
    # The sum of root and local motion is the walk, and no vertex moves.
    again = from_local(local, rooted.parents, rooted.joint_positions)
    np.testing.assert_allclose(again[:, :root], walk.transforms, atol=1e-12)
    np.testing.assert_array_equal(rooted.skin(), walk.skin())
    assert rooted.names()[-1] == "root"
    assert (rooted.parents < 0).sum() == 1
    assert rooted.parents[root] == -1


def test_the_naive_fit_agrees_where_the_motion_is_any():
    model = creature(loose=True, scaled=True)
    turn, shift = naive(model)
    motion = ground_motion(model)
    np.testing.assert_allclose(motion[:, 2, 2] + 1j * motion[:, 0, 2], turn, atol=1e-12)
    np.testing.assert_allclose(motion[:, 2, 3] + 1j * motion[:, 0, 3], shift, atol=1e-12)
    np.testing.assert_array_equal(motion[:, 1], np.tile([0, 1, 0, 0], (10, 1)))


def test_a_root_that_stands_still_and_a_name_that_is_taken():
    model = dataclasses.replace(creature(), bone_names=("root", *creature().names()[1:]))
    rooted = with_root(model, moving=False)
    assert rooted.names()[-1] == "root_1"
    np.testing.assert_array_equal(rooted.transforms[:, -1], np.tile(np.eye(3, 4), (10, 1, 1)))
    assert rooted.joint_positions[-1, 1] == model.rest[:, 1].min()


def test_without_extent_on_the_ground_the_heading_stays():
    still = np.tile(np.eye(3, 4), (3, 1, 1, 1))
    still[1, 0, :, :3] = Rotation.from_rotvec([0, 1, 0]).as_matrix()
    pole = np.array([[0, 0, 0], [0, 1, 0], [0, 2, 0.0]])
    model = ssdr.Skinning(pole, np.zeros((3, 1), int), np.ones((3, 1)), still)
    np.testing.assert_array_equal(ground_motion(model), still[[0, 0, 0], 0])


def test_the_root_is_in_a_file_and_plays_as_before(tmp_path):
    walk = moved(creature(), path("y"))
    rooted = with_root(walk)
    ssdr.save(rooted, tmp_path / "walk.glb", units=1.0, up="y")
    again = ssdr.load_skinning(tmp_path / "walk.glb")
    assert [again.names()[p] if p >= 0 else "" for p in again.parents].count("root") == 2
    np.testing.assert_allclose(again.skin(dtype=float), walk.skin(), atol=1e-3)
