"""Rigid fits and rotation formats against SciPy's, and in their degenerate cases."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import ssdr
from ssdr import kabsch
from ssdr.model import rigid
from ssdr.model.rigid import (
    matrix_from_quaternion,
    matrix_from_sixd,
    quaternion_from_matrix,
    sixd_from_matrix,
    slerp,
    unflip_quaternions,
)

seeds = st.integers(0, 2**32 - 1)


def apply(transform, points):
    return points @ np.swapaxes(transform[..., :3], -1, -2) + transform[..., None, :, 3]


def is_rotation(matrix):
    eye = np.broadcast_to(np.eye(3), matrix.shape)
    np.testing.assert_allclose(np.swapaxes(matrix, -1, -2) @ matrix, eye, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(matrix), 1, atol=1e-12)


@given(seed=seeds, count=st.integers(4, 12), noise=st.sampled_from([0.0, 0.3]))
def test_kabsch_equals_scipy(seed, count, noise):
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(count, 3))
    weights = rng.uniform(0.1, 2, count)
    truth = Rotation.random(rng=rng)
    target = truth.apply(source) + noise * rng.normal(size=(count, 3)) + [3, -2, 1]
    fit = kabsch(source, target, weights)
    share = weights / weights.sum()
    mean_s, mean_t = share @ source, share @ target
    other, _ = Rotation.align_vectors(target - mean_t, source - mean_s, weights=weights)
    np.testing.assert_allclose(fit[:, :3], other.as_matrix(), atol=1e-8)
    np.testing.assert_allclose(fit[:, :3] @ mean_s + fit[:, 3], mean_t, atol=1e-12)
    if noise == 0:
        np.testing.assert_allclose(apply(fit, source), target, atol=1e-12)


def test_kabsch_is_batched_and_broadcasts():
    rng = np.random.default_rng(1)
    source = rng.normal(size=(7, 3))
    target = rng.normal(size=(4, 5, 7, 3))
    weights = rng.uniform(size=(5, 7))
    fits = kabsch(source, target, weights)
    assert fits.shape == (4, 5, 3, 4)
    for t, b in np.ndindex(4, 5):
        alone = kabsch(source, target[t, b], weights[b])
        np.testing.assert_allclose(fits[t, b], alone, atol=1e-12)


def test_a_reflection_is_never_returned():
    rng = np.random.default_rng(2)
    source = rng.normal(size=(200, 30, 3))
    fits = kabsch(source, source * [-1, 1, 1])
    is_rotation(fits[..., :3])


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_degenerate_sets_give_the_smallest_rotation(offset):
    rng = np.random.default_rng(3)
    line = rng.normal(size=(6, 1)) * np.array([[1.0, 2.0, -0.5]])
    same = np.repeat(rng.normal(size=(1, 3)), 5, axis=0)
    tolerance = 1e-9 if offset else 1e-12
    for points in (line, same, line[:2], line[:1]):
        fit = kabsch(points + offset, points + offset)
        np.testing.assert_allclose(fit[:, :3], np.eye(3), atol=tolerance)
    turn = Rotation.from_rotvec([0.3, -1.0, 0.7])
    fit = kabsch(line + offset, turn.apply(line) + offset)
    is_rotation(fit[:, :3])
    np.testing.assert_allclose(
        apply(fit, line + offset), turn.apply(line) + offset, atol=max(1e-12, 1e-9 * offset)
    )
    # The smallest: its axis is across the line and its angle is that between the lines.
    axis = Rotation.from_matrix(fit[:, :3]).as_rotvec()
    assert abs(axis @ line[0]) < 1e-6
    a = line[0] / np.linalg.norm(line[0])
    assert np.linalg.norm(axis) == pytest.approx(np.arccos(a @ turn.apply(a)), abs=1e-6)


def test_a_line_turned_over():
    line = np.linspace(-1, 2, 5)[:, None] * np.array([[0.6, 0.0, 0.8]])
    fit = kabsch(line, -line)
    is_rotation(fit[:, :3])
    np.testing.assert_allclose(apply(fit, line), -line, atol=1e-12)


def test_planar_points_determine_the_rotation():
    rng = np.random.default_rng(4)
    flat = rng.normal(size=(10, 3)) * [1, 1, 0]
    turn = Rotation.random(20, rng=rng).as_matrix()
    fits = kabsch(flat, np.einsum("bij,nj->bni", turn, flat))
    np.testing.assert_allclose(fits[..., :3], turn, atol=1e-10)


def test_zero_weights_ignore_points_and_all_zero_is_the_identity():
    rng = np.random.default_rng(5)
    source, target = rng.normal(size=(2, 8, 3))
    weights = np.array([1, 1, 1, 1, 1, 0, 0, 0.0])
    np.testing.assert_allclose(
        kabsch(source, target, weights), kabsch(source[:5], target[:5]), atol=1e-12
    )
    nothing = kabsch(source, target, np.zeros(8))
    np.testing.assert_allclose(nothing[:, :3], np.eye(3), atol=1e-15)
    np.testing.assert_allclose(nothing[:, 3], target.mean(axis=0) - source.mean(axis=0))


@given(seed=seeds, slack=st.sampled_from([0.0, 1e-15, 1e-12, 1e-8, 1e-4, 1.0]))
def test_quaternions_round_trip_also_next_to_half_a_turn(seed, slack):
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(20, 3))
    axis[:6] = np.concatenate([np.eye(3), -np.eye(3)])
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    rotation = Rotation.from_rotvec((np.pi - slack) * axis)
    matrix = rotation.as_matrix()
    quaternion = quaternion_from_matrix(matrix)
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1, atol=1e-15)
    assert (quaternion[:, 3] >= 0).all()
    np.testing.assert_allclose(matrix_from_quaternion(quaternion), matrix, atol=1e-14)
    same = np.abs((quaternion * rotation.as_quat()).sum(axis=1))
    np.testing.assert_allclose(same, 1, atol=1e-14)


def test_quaternions_are_xyzw_and_any_length_will_do():
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # about z
    half = np.sqrt(0.5)
    np.testing.assert_allclose(quaternion_from_matrix(quarter), [0, 0, half, half], atol=1e-15)
    for q in ([0, 0, 2.0, 2.0], [0, 0, -1e-8, -1e-8]):
        np.testing.assert_allclose(matrix_from_quaternion(q), quarter, atol=1e-15)
    assert quaternion_from_matrix(np.broadcast_to(quarter, (2, 5, 3, 3))).shape == (2, 5, 4)


@given(seed=seeds)
@settings(max_examples=30)
def test_sixd_round_trip(seed):
    matrix = Rotation.random(9, rng=np.random.default_rng(seed)).as_matrix()
    np.testing.assert_allclose(matrix_from_sixd(sixd_from_matrix(matrix)), matrix, atol=1e-14)
    # Any pair of independent vectors names a rotation; the first keeps its direction.
    loose = np.random.default_rng(seed + 1).normal(size=(9, 6))
    fixed = matrix_from_sixd(loose)
    is_rotation(fixed)
    np.testing.assert_allclose(np.cross(fixed[:, :, 0], loose[:, :3]), np.zeros((9, 3)), atol=1e-12)


def test_unflip_keeps_the_rotation_and_never_jumps():
    rng = np.random.default_rng(6)
    turns = np.cumsum(0.2 * rng.normal(size=(60, 3, 3)), axis=0)
    q = np.stack([Rotation.from_rotvec(turns[:, b]).as_quat() for b in range(3)], axis=1)
    q *= rng.choice([-1.0, 1.0], size=(60, 3, 1))
    flipped = unflip_quaternions(q)
    assert ((flipped[1:] * flipped[:-1]).sum(axis=-1) >= 0).all()
    np.testing.assert_allclose(np.abs((flipped * q).sum(axis=-1)), 1, atol=1e-14)
    np.testing.assert_array_equal(flipped[0], q[0])


def test_slerp_turns_evenly_along_the_shorter_arc():
    half = np.array([0.0, 0.0, np.sin(0.3), np.cos(0.3)])
    start, third = np.array([0.0, 0.0, 0.0, 1.0]), np.array([0, 0, np.sin(0.1), np.cos(0.1)])
    u = np.array([0.0, 1 / 3, 1.0])
    for end in (half, -half):
        ways = slerp(np.tile(start, (3, 1)), np.tile(end, (3, 1)), u)
        np.testing.assert_allclose(ways, [start, third, half], atol=1e-15)
    np.testing.assert_array_equal(slerp(half, half, np.array(0.25)), half)


@pytest.mark.parametrize("power", [-300, -200, -160, -151, 151, 160, 200, 300, 307])
def test_kabsch_of_any_size(power: int) -> None:
    rotation = rigid.matrix_from_quaternion([0.1, 0.2, 0.3, 0.9])
    source = np.random.default_rng(power + 400).uniform(-1, 1, (2, 7, 3))
    size = 10.0**power
    found = ssdr.kabsch(source * size, (source @ rotation.T + [0.1, 0.2, 0.3]) * size)
    np.testing.assert_allclose(found[..., :3], np.broadcast_to(rotation, (2, 3, 3)), atol=1e-13)
    np.testing.assert_allclose(found[..., 3] / size, [[0.1, 0.2, 0.3]] * 2, atol=1e-13)
    # each of its own size, and weights of any
    found = ssdr.kabsch(source, source @ rotation.T * size, weights=np.full(7, size))
    np.testing.assert_allclose(found[..., :3], np.broadcast_to(rotation, (2, 3, 3)), atol=1e-13)


@pytest.mark.parametrize("size", [1e-310, 1e-200, 1e200, 1e308])
def test_quaternions_and_columns_of_any_length(size: float) -> None:
    quaternion, columns = np.array([0.0, 0.0, 0.6, 0.8]), np.array([1.0, 0, 0, 1, 1, 0])
    np.testing.assert_allclose(
        rigid.matrix_from_quaternion(quaternion * size),
        rigid.matrix_from_quaternion(quaternion),
        atol=1e-13,
    )
    np.testing.assert_allclose(rigid.matrix_from_sixd(columns * size), np.eye(3), atol=1e-13)
    keys = np.array([quaternion, -quaternion]) * size
    np.testing.assert_array_equal(rigid.unflip_quaternions(keys), keys[[0, 0]])
