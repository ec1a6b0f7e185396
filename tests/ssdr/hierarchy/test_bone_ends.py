"""Bones from joint to joint, as programs draw them."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.rig_tree import ENDS, NAMES, PARENTS, POSITIONS, creature
from ssdr.hierarchy.bone_ends import limb_axes, limb_ends
from ssdr.io.gltf.gltf_writing import orient_joints
from ssdr.io.rig import build_rig


def _ends(model):
    return limb_ends(model.joint_positions, model.parents, model.rest, model.indices, model.weights)


def test_a_bone_ends_where_the_next_begins():
    ends = _ends(creature())
    leg, foot = NAMES.index("leg"), NAMES.index("foot")
    np.testing.assert_allclose(ends[leg], POSITIONS[foot])
    chest = NAMES.index("chest")  # two arms: their middle
    np.testing.assert_allclose(ends[chest], POSITIONS[[1, 3]].mean(axis=0))


def test_a_leaf_reaches_as_far_as_what_it_moves():
    ends = _ends(creature())
    for name in ("arm.L", "arm.R", "foot", "ball"):
        b = NAMES.index(name)
        assert np.linalg.norm(ends[b] - ENDS[b]) < 0.15 * np.linalg.norm(ENDS[b] - POSITIONS[b])


def test_no_bone_ends_at_a_joint_that_slides():
    model = creature()
    tree = model.joint_positions, model.parents, model.rest, model.indices, model.weights
    leg, foot = NAMES.index("leg"), NAMES.index("foot")
    ends = limb_ends(*tree, sliding=np.arange(7) == foot)
    length = np.linalg.norm(POSITIONS[foot] - POSITIONS[leg])
    assert 1e-3 * length < np.linalg.norm(ends[leg] - POSITIONS[foot]) < 3e-3 * length
    np.testing.assert_array_equal(ends[1:4], limb_ends(*tree)[1:4])


def test_children_on_all_sides_leave_the_longest_chain():
    at = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [2, 0, 0.0]])
    rest = np.array([[3, 0, 0], [-2, 0, 0], [0, 1, 0.0]])
    indices, weights = np.array([[3], [2], [0]]), np.ones((3, 1))
    ends = limb_ends(at, np.array([-1, 0, 0, 1]), rest, indices, weights)
    np.testing.assert_allclose(ends[0], at[1])


def test_no_bone_is_without_length():
    at = np.zeros((4, 3))
    rest = np.array([[0.0, 0, 0], [2, 0, 0]])
    ends = limb_ends(at, np.array([-1, 0, 1, -1]), rest, np.zeros((2, 1), int), np.ones((2, 1)))
    assert (np.linalg.norm(ends - at, axis=1) > 0.0199).all()
    one = limb_ends(
        at[:1], np.array([-1]), np.zeros((1, 3)), np.zeros((1, 1), int), np.ones((1, 1))
    )
    assert 0 < np.linalg.norm(one) < np.inf


@pytest.mark.parametrize("down", [False, True])
def test_axes_are_rotations_along_the_bones(down):
    model = creature()
    ends = _ends(model)
    if down:
        ends = POSITIONS - np.eye(3)[1]  # against the axis of the world
    axes = limb_axes(POSITIONS, np.array(PARENTS), ends)
    np.testing.assert_allclose(
        axes @ np.swapaxes(axes, 1, 2), np.tile(np.eye(3), (7, 1, 1)), atol=1e-12
    )
    assert (np.linalg.det(axes) > 0).all()
    along = ends - POSITIONS
    np.testing.assert_allclose(
        axes[:, :, 1], along / np.linalg.norm(along, axis=1, keepdims=True), atol=1e-12
    )


@pytest.mark.parametrize("kind", [{}, {"loose": True}, {"scaled": True}])
def test_turned_joints_move_alike_at_frames_and_between(kind):
    model = creature(**kind)
    rig = build_rig(model)
    turned = orient_joints(rig, limb_axes(rig.centers, rig.parents, _ends(model)))
    times = np.arange(0, model.n_frames - 1, 0.5)
    np.testing.assert_allclose(turned.matrices(times), rig.matrices(times), atol=2e-6)
    assert turned.error(model)[1] < 1e-6 * 3.2
