"""Bones from joint to joint, as programs draw them."""

from __future__ import annotations

import numpy as np

from helpers.rig_tree import ENDS, NAMES, POSITIONS, creature
from ssdr.model.bone_ends import limb_ends


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
