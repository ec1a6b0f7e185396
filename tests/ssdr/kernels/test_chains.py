"""Kernels of chains against finite differences, transposes and dense sums."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssdr.kernels.chains import chain_image, chain_matrix, chain_move, chain_pullback
from ssdr.model.transforms import joint_gaps, parents_first

PARENTS = np.array([2, 0, -1, 0, -1])
N, F = len(PARENTS), 3


@pytest.fixture
def chain():
    rng = np.random.default_rng(0)
    transforms = np.empty((F, N, 3, 4))
    transforms[..., :3] = Rotation.random(F * N, random_state=1).as_matrix().reshape(F, N, 3, 3)
    transforms[..., 3] = rng.normal(size=(F, N, 3))
    points = rng.normal(size=(N, 3))
    still = np.zeros((F, N, 3))
    _move(transforms, points, still, still)
    turns, shifts, moved = (
        rng.normal(size=(F, N, 3)),
        rng.normal(size=(F, N, 3)),
        rng.normal(size=(N, 3)),
    )
    shifts[:, PARENTS >= 0] = 0.0
    moved[PARENTS < 0] = 0.0
    return rng, transforms, points, turns, shifts, moved


def _move(transforms, points, turns, shifts):
    chain_move(transforms, parents_first(PARENTS), PARENTS, points, turns, shifts)


def _image(transforms, points, turns, shifts, moved):
    out = np.empty((F, N, 6))
    order = parents_first(PARENTS)
    chain_image(transforms, order, PARENTS, points, turns, shifts, moved, out)
    return out


def test_bones_hang_on_their_joints_after_a_move(chain):
    _, transforms, points, turns, shifts, _ = chain
    assert joint_gaps(transforms, PARENTS, points).max() < 1e-14
    _move(transforms, points, turns, shifts)
    assert joint_gaps(transforms, PARENTS, points).max() < 1e-14
    turn = transforms[..., :3]
    assert np.abs(np.swapaxes(turn, -1, -2) @ turn - np.eye(3)).max() < 1e-14


def test_the_image_is_the_derivative_of_a_move(chain):
    rng, transforms, points, turns, shifts, moved = chain
    tangents = _image(transforms, points, turns, shifts, moved)
    step = 1e-6
    ends = []
    for sign in (1, -1):
        end = transforms.copy()
        _move(end, points + sign * step * moved, sign * step * turns, sign * step * shifts)
        ends.append(end)
    slope = (ends[0] - ends[1]) / (2 * step)
    p = rng.normal(size=3)
    expected = slope[..., :3] @ p + slope[..., 3]
    change = np.cross(tangents[..., :3], p) + tangents[..., 3:]
    found = np.einsum("tjab,tjb->tja", transforms[..., :3], change)
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_the_pullback_is_the_transpose_of_the_image(chain):
    rng, transforms, points, turns, shifts, moved = chain
    g = rng.normal(size=(F, N, 6))
    forward = float(np.vdot(g, _image(transforms, points, turns, shifts, moved)))
    to_turns, to_shifts, to_moved = np.empty((F, N, 3)), np.empty((F, N, 3)), np.zeros((N, 3))
    order = parents_first(PARENTS)
    chain_pullback(transforms, order, PARENTS, points, g.copy(), to_turns, to_shifts, to_moved)
    back = np.vdot(to_turns, turns) + np.vdot(to_shifts, shifts) + np.vdot(to_moved, moved)
    assert back == pytest.approx(forward, rel=1e-12)
    assert (to_shifts[:, PARENTS >= 0] == 0).all()
    assert (to_moved[PARENTS < 0] == 0).all()


def test_the_matrix_is_that_of_the_vertices(chain):
    rng, transforms, points, turns, shifts, moved = chain
    rest, weights, scale = rng.normal(size=(40, 3)), rng.random((40, N)), rng.random(F) + 0.5
    weights[:, 1] *= rng.random(40) > 0.7
    weights[weights[:, 1] > 0, 4] = 0.0  # two bones that share no vertex
    homogeneous = np.c_[rest, np.ones(40)]
    u = np.einsum("ij,ik,ia,ib->jkab", weights, weights, homogeneous, homogeneous)
    matrix = np.zeros((N, 6, N, 6))
    order = parents_first(PARENTS)
    chain_matrix(transforms, order, PARENTS, points, u, scale, matrix)
    np.testing.assert_allclose(matrix, matrix.transpose(2, 3, 0, 1), atol=1e-11)
    # one frame's unknowns at a time: the matrix is the sum over frames of the same unknowns
    x = np.concatenate([turns[0], shifts[0] + moved], axis=1)
    everywhere = [np.broadcast_to(part, (F, N, 3)).copy() for part in (turns[0], shifts[0])]
    tangents = _image(transforms, points, *everywhere, moved)
    change = np.cross(tangents[:, :, None, :3], rest) + tangents[:, :, None, 3:]
    world = np.einsum("ij,tjab,tjib->tia", weights, transforms[..., :3], change)
    expected = float((scale[:, None, None] * world**2).sum())
    assert np.einsum("ja,jakb,kb->", x, matrix, x) == pytest.approx(expected, rel=1e-12)
