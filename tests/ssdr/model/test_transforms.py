"""Bones that hang on joints: local transforms, poses, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ssdr
from ssdr.model.transforms import from_local, joint_gaps, parents_first, to_local

PARENTS = [2, 0, -1, 0, -1]


def _tree(frames=4, seed=0):
    rng = np.random.default_rng(seed)
    n = len(PARENTS)
    positions = rng.normal(size=(n, 3))
    turns = Rotation.random(frames * n, random_state=seed).as_matrix().reshape(frames, n, 3, 3)
    roots = rng.normal(size=(frames, 2, 3))
    rest = rng.normal(size=(30, 3))
    indices = rng.integers(0, n, size=(30, 2))
    weights = rng.dirichlet([1, 1], size=30)
    still = np.broadcast_to(np.eye(3, 4), (1, n, 3, 4))
    model = ssdr.Skinning(rest, indices, weights, still, parents=PARENTS, joint_positions=positions)
    return model, turns, roots


def _naive_pose(parents, positions, turns, roots):
    """Frame by frame and bone by bone, by 4×4 matrices."""
    out = np.empty((len(turns), len(parents), 3, 4))
    for t in range(len(turns)):
        frames = {}

        def frame(b, t=t, frames=frames):
            if b not in frames:
                local = np.eye(4)
                local[:3, :3] = turns[t, b]
                if parents[b] < 0:
                    local[:3, 3] = roots[
                        t, [a for a in range(len(parents)) if parents[a] < 0].index(b)
                    ]
                    frames[b] = local
                else:
                    local[:3, 3] = positions[b] - positions[parents[b]]
                    frames[b] = frame(parents[b]) @ local
            return frames[b]

        for b in range(len(parents)):
            bind = np.eye(4)
            bind[:3, 3] = -positions[b]
            out[t, b] = (frame(b) @ bind)[:3]
    return out


@pytest.mark.parametrize("quaternions", [False, True])
def test_a_pose_is_that_of_plain_matrices(quaternions):
    model, turns, roots = _tree()
    given = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_quat().reshape(4, -1, 4)
    posed = model.pose(given if quaternions else turns, roots)
    naive = _naive_pose(PARENTS, model.joint_positions, turns, roots)
    np.testing.assert_allclose(posed.transforms, naive, atol=1e-12)
    assert posed.n_frames == 4
    assert posed.joint_gaps().max() < 1e-12


def test_no_rotation_is_the_rest_pose():
    model, _, _ = _tree()
    rest = model.pose(np.broadcast_to(np.eye(3), (model.n_bones, 3, 3)))
    np.testing.assert_allclose(rest.skin()[0], model.rest, atol=1e-12)


def test_local_transforms_lead_back():
    model, turns, roots = _tree()
    posed = model.pose(turns, roots)
    local = posed.local_transforms()
    np.testing.assert_allclose(local[..., :3], turns, atol=1e-12)
    np.testing.assert_allclose(local[..., 3][:, [2, 4]], roots, atol=1e-12)
    back = from_local(local, posed.parents, posed.joint_positions)
    np.testing.assert_allclose(back, posed.transforms, atol=1e-12)


def test_local_transforms_of_free_bones_lead_back_too():
    model, _, _ = _tree()
    rng = np.random.default_rng(3)
    free = rng.normal(size=(3, 5, 3, 4))
    local = to_local(free, model.parents, model.joint_positions)
    back = from_local(local, model.parents, model.joint_positions)
    np.testing.assert_allclose(back, free, atol=1e-10)


def test_the_gap_of_a_joint_is_the_distance_of_its_two_images():
    model, _, _ = _tree()
    free = np.random.default_rng(3).normal(size=(3, 5, 3, 4))
    gaps = joint_gaps(free, model.parents, model.joint_positions)
    for t in range(3):
        for b, a in enumerate(PARENTS):
            point = np.append(model.joint_positions[b], 1.0)
            expected = 0.0 if a < 0 else np.linalg.norm(free[t, b] @ point - free[t, a] @ point)
            assert gaps[t, b] == pytest.approx(expected, abs=1e-12)


def test_parents_come_first():
    order = parents_first(np.array(PARENTS)).tolist()
    for b, a in enumerate(PARENTS):
        assert a < 0 or order.index(a) < order.index(b)


def test_the_hierarchy_survives_pruning_and_picking_clips():
    model, turns, roots = _tree()
    posed = model.pose(turns, roots)
    for other in (posed.prune(1), posed.select(0)):
        assert other.parents.tolist() == PARENTS
        np.testing.assert_array_equal(other.joint_positions, model.joint_positions)
