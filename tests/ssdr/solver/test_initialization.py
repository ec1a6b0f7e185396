"""Where bones start: farthest points, rigid patches, a choice among them."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

import ssdr
from helpers import motions, naive
from ssdr.solver.initialization import (
    facility_location,
    farthest_points,
    fit_patches,
    single_bone_errors,
    start_model,
)
from ssdr.solver.trajectories import find_parts, gather


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 12))
def test_farthest_points_against_loops(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((30, 5))
    seeds, label = farthest_points(x, count, 3)
    want = [3]
    while len(want) < count:
        near = [min(np.linalg.norm(row - x[s]) for s in want) for row in x]
        want.append(int(np.argmax(near)))
    assert list(seeds) == want
    distance = np.linalg.norm(x[:, None] - x[seeds][None], axis=2)
    assert np.array_equal(label, distance.argmin(axis=1))


def test_farthest_points_stop_at_copies() -> None:
    x = np.repeat(np.eye(3), 4, axis=0)
    seeds, label = farthest_points(x, 10, 0)
    assert len(seeds) == 3
    for s in range(3):
        assert len(set(label[4 * s : 4 * s + 4])) == 1


def test_patches_are_kabsch(rng: np.random.Generator) -> None:
    frames = rng.standard_normal((4, 30, 3))
    importance = 0.1 + rng.random(30)
    data = gather([ssdr.MeshSequence(frames)], bones=99, vertex_importance=importance)
    rest = rng.standard_normal((30, 3))
    label = rng.integers(-1, 3, 30)
    fitted = fit_patches(data, rest, label, 4)
    for j in range(3):
        mine = label == j
        for t in range(4):
            want = ssdr.kabsch(rest[mine], data.frame(t)[mine], importance[mine])
            np.testing.assert_allclose(fitted[t, j], want, atol=1e-7)
    assert np.array_equal(fitted[:, 3], np.tile(np.eye(4)[:3], (4, 1, 1)))


def test_single_bone_errors_against_loops(rng: np.random.Generator) -> None:
    frames = rng.standard_normal((5, 12, 3))
    data = gather([ssdr.MeshSequence(frames)], bones=99)
    rest, transforms = rng.standard_normal((12, 3)), motions.motions(rng, 5, 3)
    inner = np.stack([data.frame(t) for t in range(5)])
    rows = np.array([7, 2, 3])
    cost = single_bone_errors(data, rest, transforms, rows)
    one = np.ones((12, 1))
    for j in range(3):
        indices = np.full((12, 1), j)
        want = naive.squared_error(inner, rest, indices, one, transforms)
        np.testing.assert_allclose(cost[:, j], want[rows], rtol=1e-9)


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 5))
def test_choice_is_greedy(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    cost, importance = rng.random((15, 8)), rng.random(15)
    got = facility_location(cost, importance, count)
    chosen: list[int] = []
    for _ in range(count):
        totals = []
        for j in range(8):
            near = cost[:, [*chosen, j]].min(axis=1)
            totals.append(np.inf if j in chosen else (importance * near).sum())
        chosen.append(int(np.argmin(totals)))
    assert got == chosen


def test_rounding_does_not_choose_among_vertices_that_move_alike() -> None:
    """A flag with waves that come round: many vertices move as far as another, to rounding."""
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1.5, 31), np.linspace(-0.5, 0.5, 21)))
    t = np.linspace(0, 2 * np.pi, 40, endpoint=False)[:, None]
    waves = 0.18 * x * np.sin(6 * x - 2 * t + 1.5 * y)
    out = x - 0.06 * x**2 * (1 + np.sin(2 * t))
    shots = np.stack([out, y + 0.03 * x * np.cos(3 * t), waves], axis=2)
    one = ssdr.initialize(shots, bones=12)
    for unit in (1000.0, 2.54, 1e-6):
        other = ssdr.initialize(unit * shots, bones=12)
        np.testing.assert_allclose(other.dense_weights(), one.dense_weights(), atol=1e-6)
        np.testing.assert_allclose(other.rest, unit * one.rest, atol=1e-6 * unit)


def test_parts_by_hand(rng: np.random.Generator) -> None:
    """Two triangles that share vertex 2, a rigid one, an edge that has lost its area, a point."""
    faces = np.array([[0, 1, 2], [4, 5, 6], [2, 3, 1], [7, 8, 8]], dtype=np.int32)
    x = rng.standard_normal((10, 3, 3))
    x[4:7] = x[4:7, :1] + np.arange(3)[:, None]
    assert list(find_parts(faces, x)) == [-2, -2, -2, -2, 1, 1, 1, -1, -1, -1]
    assert find_parts(faces[[0, 2, 3]], x) is None
    assert find_parts(faces[:0], x) is None


def test_which_parts_are_rigid() -> None:
    exact = motions.pieces(3)
    frames = exact.frames
    frames[:, :8] *= np.linspace(1, 1.1, len(frames))[:, None, None]  # swells
    data = gather([ssdr.MeshSequence(frames, exact.faces)], bones=3)
    assert list(data.parts) == 8 * [-2] + 8 * [1] + 8 * [2]


@settings(max_examples=10)
@given(seed=st.integers(0, 10**6), few=st.integers(2, 9), quick=st.booleans())
def test_a_start_cuts_no_rigid_part(seed: int, few: int, quick: bool) -> None:
    """Twelve pieces, of which three move as one: exact with ten bones, and whole with fewer."""
    exact = motions.pieces(12, seed=seed % 50)
    exact.transforms[:, [4, 8]] = exact.transforms[:, :1]
    data = gather([ssdr.MeshSequence(exact.frames, exact.faces)], bones=10)
    for bones in (few, 10, 13):
        rng = np.random.default_rng(seed)
        model = start_model(data, data.frame(0), bones, 1, rng, quick=quick)
        owner = model.indices.reshape(12, 8)
        assert (owner == owner[:, :1]).all()
        assert len(np.unique(owner)) >= min(bones, 10)
        if bones >= 10:
            bone = model.transforms[:, owner[:, 0]]
            moved = np.einsum("tbij,bvj->tbvi", bone[..., :3], model.rest.reshape(12, 8, 3))
            moved += bone[..., None, :, 3]
            inner = np.stack([data.frame(t) for t in range(data.n_frames)])
            np.testing.assert_allclose(moved.reshape(inner.shape), inner, atol=1e-12)
