"""Keys: the fewest that hold the error, and motion between them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import ssdr
from helpers import motions
from helpers.measures import wavy
from ssdr.io.played_model import as_played
from ssdr.model.keyframes import Tracks


@pytest.mark.parametrize("price", [1e-6, 1e-4, 1e-2])
def test_keys_are_the_best_of_all_subsets(price: float) -> None:
    rig = motions.boxes(1, frames=7, seed=3)
    rng = np.random.default_rng(0)
    transforms = motions.motions(rng, 7, 1, turn=0.05, shift=0.05)
    model = ssdr.Skinning(rig.rest, rig.indices, rig.weights, transforms)
    tracks = Tracks(model, np.array([0, 7]))
    keys, said = tracks.choose(price)
    masks = [np.arange(7) == t for t in range(7)]
    masks += [np.array([True, *m, True]) for m in itertools.product([False, True], repeat=5)]

    def error_and_bytes(mask: np.ndarray) -> tuple[float, int]:
        added = float(((tracks.play(mask).skin() - model.skin()) ** 2).sum())
        return added, 7 * 28 if mask.all() else 30 * int(mask.sum())

    costs = [error + price * size for error, size in (error_and_bytes(m[:, None]) for m in masks)]
    added, size = error_and_bytes(keys)
    assert said + price * size == pytest.approx(min(costs), rel=1e-9)
    # one influence a vertex: what is said is what is added
    assert said == pytest.approx(added, rel=1e-9, abs=1e-15)


def test_keys_of_shared_vertices_cost_at_most_what_is_said() -> None:
    skinning = ssdr.decompose(wavy(), bones=5, effort="fast").skinning
    tracks = Tracks(skinning, np.array([0, 15]))
    for price in (1e-5, 1e-3, 1e-1):
        keys, said = tracks.choose(price)
        played = tracks.play(keys)
        added = float(((played.skin() - skinning.skin()) ** 2).sum())
        assert added <= said * (1 + 1e-9)
        assert (played.transforms[keys] == skinning.transforms[keys]).all()


def test_between_keys_bones_move_as_engines_move_them() -> None:
    skinning = ssdr.decompose(wavy(), bones=4, effort="fast").skinning
    tracks = Tracks(skinning, np.array([0, 15]))
    keys = np.zeros((15, 4), dtype=bool)
    keys[[0, 3, 8, 14]] = True
    played = tracks.play(keys)
    at = np.flatnonzero(keys[:, 0])
    centre = skinning.centroids()
    for b in range(4):
        m = skinning.transforms[at, b]
        turn = Slerp(at, Rotation.from_matrix(m[..., :3]))(np.arange(15)).as_matrix()
        place = m[..., :3] @ centre[b] + m[..., 3]
        path = np.stack([np.interp(np.arange(15), at, place[:, c]) for c in range(3)], axis=1)
        assert np.abs(played.transforms[:, b, :, :3] - turn).max() < 1e-9
        moved = played.transforms[:, b, :, :3] @ centre[b] + played.transforms[:, b, :, 3]
        assert np.abs(moved - path).max() < 1e-9
    # and so does what is exported
    rig = as_played(played)
    assert (rig.keys == keys).all()
    assert np.abs(rig.matrices(np.arange(15.0)) - played.transforms).max() < 1e-5


def test_a_steady_turn_needs_two_keys() -> None:
    axis = np.array([0.1, 0.2, -0.15])
    rest = np.random.default_rng(0).standard_normal((30, 3))
    rest -= rest.mean(axis=0)
    frames = np.stack([rest @ motions.rotation(*(0.3 * t * axis)).T for t in range(20)])
    result = ssdr.smallest(frames + np.array([1.0, 2.0, 3.0]), tolerance="0.001%")
    assert result.skinning.keyframes is not None
    assert np.flatnonzero(result.skinning.keyframes[:, 0]).tolist() == [0, 19]


def test_affine_bones_between_keys_do_not_turn_over() -> None:
    """Half a turn while one side grows and one shrinks: straight from the first matrix to the
    last det falls below 0, and two keys would do for the place."""
    rng = np.random.default_rng(0)
    transforms = np.zeros((9, 2, 3, 4))
    for t in range(9):
        grown = np.diag([1 + t / 8, 1, 1 - t / 16])
        transforms[t, :, :, :3] = motions.rotation(0, np.pi * t / 8, 0) @ grown
        transforms[t, :, 0, 3] = 100 * t
    halfway = 0.5 * (transforms[0] + transforms[8])[..., :3]
    assert np.linalg.det(halfway).max() < 0
    model = ssdr.Skinning(
        rng.standard_normal((20, 3)),
        np.arange(20)[:, None] % 2,
        np.ones((20, 1)),
        transforms,
        bone_model="affine",
    )
    tracks = Tracks(model, np.array([0, 9]))
    for price in (1e-3, 1.0, 10.0, 100.0):
        keys, _ = tracks.choose(price)
        assert np.linalg.det(tracks.play(keys).transforms[..., :3]).min() > 0
    assert keys.sum(axis=0).max() < 5
