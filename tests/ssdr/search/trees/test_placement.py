"""Joints from motion: exact ones are found, what motion leaves open is decided by the skin."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import motions, trees
from ssdr.model.transforms import joint_gaps
from ssdr.search.trees.placement import (
    find_contacts,
    fit_joint,
    fit_joints,
    snap_to_joints,
    spanning_tree,
    step_with_joint_penalty,
)
from ssdr.solver.alternation import bone_step, vertex_step
from ssdr.solver.model import FREE, Model
from ssdr.solver.trajectories import gather


def _model(made, influences=4):
    data = gather([ssdr.MeshSequence(made.frames)], bones=len(made.parents))
    rest, transforms = motions.in_solver(data, made.rest, made.transforms)
    model = Model.start(transforms.copy(), rest, made.indices[:, 0], influences)
    model.indices[:, :2], model.weights[:, :2] = made.indices, made.weights
    model.restart_support()
    return data, model


def test_gaps_and_joints_against_loops():
    rng = np.random.default_rng(0)
    transforms = motions.motions(rng, 6, 3)
    prior = rng.normal(size=(3, 3, 3))
    prior = prior + prior.transpose(1, 0, 2)
    points, gap = fit_joints(transforms, prior)
    for a in range(3):
        for b in range(3):
            rows, right = [], []
            for t in range(6):
                apart = transforms[t, a] - transforms[t, b]
                rows += [apart[:, :3], np.sqrt(1e-3) * np.eye(3)]
                right += [-apart[:, 3], np.sqrt(1e-3) * prior[a, b]]
            best = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right))[0]
            np.testing.assert_allclose(points[a, b], best, atol=1e-9)
            apart = transforms[:, a] - transforms[:, b]
            expected = ((apart[..., :3] @ best + apart[..., 3]) ** 2).sum()
            assert gap[a, b] == pytest.approx(expected, abs=1e-9)
    one, of_one = fit_joint(
        Model.start(transforms, prior[0], np.zeros(3, int), 1), 0, 2, prior[0, 2]
    )
    np.testing.assert_allclose(one, points[0, 2], atol=1e-12)
    assert of_one == pytest.approx(gap[0, 2])


def test_exact_bones_give_their_tree_and_joints():
    made = trees.skeleton(9, 40, seed=1)
    data, model = _model(made)
    tree = spanning_tree(model)
    assert trees.edges(tree.parents) == trees.edges(made.parents)
    points = tree.points * data.alignment.scale + data.alignment.centre[0]
    for k in tree.non_roots:
        child = k if made.parents[k] == tree.parents[k] else tree.parents[k]
        assert np.linalg.norm(points[k] - made.points[child]) < 0.02


def test_a_bone_that_moves_nothing_hangs_on_the_tree_too():
    _, model = _model(trees.skeleton(9, 40, seed=1))
    empty = model.with_bone(model.transforms[:, 3])
    assert (spanning_tree(empty).parents < 0).sum() == 1


def test_rings_a_third_of_the_size_apart_that_move_together_share_a_tree():
    """A game character's tail has a few rings of vertices; what flies about apart has none."""
    angle = np.linspace(0, 2 * np.pi, 7)[:-1]
    ring = 0.1 * np.stack([np.zeros(6), np.cos(angle), np.sin(angle)], axis=1)
    rest = np.concatenate(
        [ring + np.array([x, 0.0, 0.0]) for x in (-1.4, -1.0, -0.6, 0.6, 1.0, 1.4)]
    )
    bones = np.repeat([0, 1], 18)  # 1.2 apart, the size is 1.06
    near = np.where(np.arange(36)[:, None] < 18, rest + np.array([0.75, 0, 0]), rest)  # 0.45
    turn = motions.motions(np.random.default_rng(0), 20, 1)
    turn[..., 3] = 0.0  # about where both hang together
    for points, roots in ((near, 1), (rest, 2)):
        transforms = np.repeat(np.eye(3, 4)[None, None], 20, axis=0).repeat(2, axis=1)
        transforms[:, 1] = turn[:, 0]
        transforms[:, 1, 2, 3] += 0.07 * np.tile([1.0, -1.0], 10)  # and come apart a little
        if roots == 2:
            transforms[:, 1, 0, 3] += np.linspace(0, 2, 20)
            transforms[:, 1, 1, 3] += np.linspace(0, 2, 20) ** 2
        model = Model.start(transforms, points, bones, 1)
        assert (spanning_tree(model).parents < 0).sum() == roots


def test_pieces_that_touch_and_turn_apart_share_no_joint():
    """Two wheels that touch; as parts of one mesh they are connected all the same."""
    angle = np.linspace(0, 2 * np.pi, 25)[:-1]
    wheel = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    rest = np.concatenate([wheel, wheel + np.array([2.0, 0, 0])])
    turn = motions.rotation(0, 0, 0.2)
    transforms = np.zeros((16, 2, 3, 4))
    for t in range(16):
        way = np.linalg.matrix_power(turn, t)
        transforms[t, 0, :, :3], transforms[t, 1, :, :3] = way, way.T
        transforms[t, 1, :, 3] = [2.0, 0, 0] - way.T @ [2.0, 0, 0]
    bones = np.repeat([0, 1], 24)
    model = Model.start(transforms, rest, bones, 1)
    for parts, roots in ((None, 1), (0 * bones, 1), (bones, 2)):
        assert (spanning_tree(model, parts=parts).parents < 0).sum() == roots


def test_what_motion_leaves_open_is_where_the_skin_meets():
    still = np.broadcast_to(np.eye(3, 4), (5, 2, 3, 4)).copy()
    rest = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])
    model = Model.start(still, rest, np.array([0, 0, 1, 1]), 2)
    meet = find_contacts(model)
    points, gap = fit_joints(still, meet.points)
    np.testing.assert_allclose(points[0, 1], [1.5, 0, 0], atol=1e-12)
    assert gap.max() == 0
    model.indices[1:3], model.weights[1:3] = [[0, 1], [1, 0]], [[0.75, 0.25], [0.75, 0.25]]
    np.testing.assert_allclose(find_contacts(model).points[0, 1], [1.5, 0, 0], atol=1e-12)


def test_masses_are_sums_of_squared_weights():
    made = trees.skeleton(5, 4)
    _, model = _model(made)
    dense = np.zeros((len(made.rest), 5))
    for k in range(2):
        np.add.at(dense, (np.arange(len(dense)), made.indices[:, k]), made.weights[:, k])
    np.testing.assert_allclose(model.bone_masses(), (dense**2).sum(axis=0), atol=1e-12)


def test_a_stiffer_penalty_closes_the_gaps():
    made = trees.skeleton(7, 30, seed=2)
    rng = np.random.default_rng(0)
    noisy = made.frames + 0.05 * rng.normal(size=made.frames.shape)
    data = gather([ssdr.MeshSequence(noisy)], bones=7)
    rest, transforms = motions.in_solver(data, made.rest, made.transforms)
    model = Model.start(transforms.copy(), rest, made.indices[:, 0], 2)
    vertex_step(data, model)
    for _ in range(4):  # bones of their own, each by its own vertices
        model.tree = None
        bone_step(data, model)
        vertex_step(data, model)
    model.tree = spanning_tree(model)
    gaps = []
    for stiffness in (1e-2, 1.0, 100.0):
        for _ in range(3):
            step_with_joint_penalty(data, model, stiffness, FREE)
        gaps.append(joint_gaps(model.transforms, model.tree.parents, model.tree.points).max())
    assert gaps[0] > 3 * gaps[1] > 9 * gaps[2]
    snap_to_joints(data, model, FREE)
    assert model.tree.rigid
    assert joint_gaps(model.transforms, model.tree.parents, model.tree.points).max() < 1e-13
