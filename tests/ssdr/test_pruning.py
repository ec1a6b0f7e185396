"""What a model gives up to be small, and what each of it is said to cost."""

from __future__ import annotations

import itertools
from pathlib import Path

import motions
import numpy as np
import pytest
from measures import rmse_of, small, solved, wavy
from scipy.spatial.transform import Rotation, Slerp

import ssdr
from ssdr import parsimony
from ssdr.io.rig import build_rig
from ssdr.parsimony.influences import nest
from ssdr.parsimony.keyframes import Tracks
from ssdr.solver.model import Fixed
from ssdr.solver.trajectories import gather


def test_every_pruning_says_what_it_cost() -> None:
    found = small().parsimony
    assert found is not None
    assert [p.what for p in found.prunings] == ["bones", "influences", "keyframes"]
    bones, influences, keyframes = found.prunings
    assert bones.before >= bones.after == found.bones
    assert influences.after < influences.before
    assert influences.bytes_after < influences.bytes_before
    assert keyframes.bytes_after <= keyframes.bytes_before
    assert influences.error_after == keyframes.error_before
    assert keyframes.error_after == found.error
    assert keyframes.bytes_after == found.size.total == parsimony.size(small().skinning).total
    assert influences.after == (small().skinning.weights > 0).sum()
    assert small().skinning.keyframes is not None
    assert keyframes.after == small().skinning.keyframes.sum()
    for p in found.prunings:
        assert p.cost == p.error_after - p.error_before
    tried = {a.bones for a in found.attempts}
    assert found.bones in tried
    assert found.bones == found.least_bones or found.bones - 1 in tried


def test_size_by_hand() -> None:
    joints = np.array([[0, 1], [1, 0], [2, 0]])
    weights = np.array([[0.5, 0.5], [1.0, 0.0], [1.0, 0.0]])
    keys = np.zeros((5, 3), dtype=bool)
    keys[:, 0] = True  # every frame: no times
    keys[[0, 4], 1] = True
    keys[0, 2] = True
    model = ssdr.Skinning(
        np.zeros((3, 3)), joints, weights, np.tile(np.eye(4)[:3], (5, 3, 1, 1)), keyframes=keys
    )
    size = parsimony.size(model)
    assert size == parsimony.Size(
        rest=3 * 12, weights=3 * 1 + 4 * 3, joints=3 * 12, keys=5 * 28 + 2 * 30 + 30
    )
    assert size.total == 36 + 15 + 36 + 230
    whole = ssdr.Skinning(
        np.zeros((1, 3)), [[0]], [[1.0]], np.tile(np.eye(4)[:3], (2, 300, 1, 1)),
        bone_model="affine",
    )  # fmt: skip
    assert parsimony.size(whole).total == 12 + (1 + 4) + 300 * 12 + 2 * 300 * 48


def test_dropped_influences_cost_what_is_said() -> None:
    data = gather([ssdr.MeshSequence(wavy())], bones=5)
    nested = nest(data, solved(data, 5), fixed=Fixed())
    assert (np.diff(nested.counts, axis=0) <= 0).all()
    assert (nested.counts[-1] == 1).all()
    assert (np.diff(nested.errors.sum(axis=1)) > 0).all()
    cheap, none = nested.choose(data.importance, 0.0)
    assert none == pytest.approx(nested.errors.min(axis=0).sum())
    level, error = nested.choose(data.importance, 1e-4)
    assert (level >= cheap).all()
    model = nested.build(level)
    rest, transforms = data.to_world(model.rest, model.transforms)
    built = ssdr.Skinning(rest, model.joints, model.weights, transforms)
    count = 15 * 84
    assert rmse_of(built, wavy()) == pytest.approx(data.scale * np.sqrt(error / count), rel=1e-6)
    assert (model.weights > 0).sum() == np.take_along_axis(nested.counts, level[None], 0).sum()


@pytest.mark.parametrize("price", [1e-6, 1e-4, 1e-2])
def test_keys_are_the_best_of_all_subsets(price: float) -> None:
    rig = motions.boxes(1, frames=7, seed=3)
    rng = np.random.default_rng(0)
    transforms = motions.motions(rng, 7, 1, turn=0.05, shift=0.05)
    model = ssdr.Skinning(rig.rest, rig.joints, rig.weights, transforms)
    tracks = Tracks(model, np.array([0, 7]))
    keys, said = tracks.choose(price)
    best = np.inf
    full = model.skin()
    for inner in itertools.product([False, True], repeat=5):
        mask = np.array([True, *inner, True])[:, None]
        error = float(((tracks.play(mask).skin() - full) ** 2).sum())
        bytes_ = 7 * 28 if mask.all() else 30 * int(mask.sum())
        best = min(best, error + price * bytes_)
    for t in range(7):
        mask = np.arange(7)[:, None] == t
        error = float(((tracks.play(mask).skin() - full) ** 2).sum())
        best = min(best, error + price * 30)
    bytes_ = 7 * 28 if keys.all() else 30 * int(keys.sum())
    assert said + price * bytes_ == pytest.approx(best, rel=1e-9)
    # one influence a vertex: what is said is what is added
    added = float(((tracks.play(keys).skin() - full) ** 2).sum())
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
    rig = build_rig(played)
    assert (rig.keys == keys).all()
    assert np.abs(rig.matrices(np.arange(15.0)) - played.transforms).max() < 1e-5


def test_a_steady_turn_needs_two_keys() -> None:
    axis = np.array([0.1, 0.2, -0.15])
    rest = np.random.default_rng(0).standard_normal((30, 3))
    rest -= rest.mean(axis=0)
    frames = np.stack([rest @ motions.rotation(*(0.3 * t * axis)).T for t in range(20)])
    result = ssdr.decompose(frames + np.array([1.0, 2.0, 3.0]), tolerance="0.001%")
    assert result.skinning.keyframes is not None
    assert np.flatnonzero(result.skinning.keyframes[:, 0]).tolist() == [0, 19]


def test_the_result_goes_through_a_file(tmp_path: Path) -> None:
    path = tmp_path / "model.npz"
    ssdr.save(small(), path)
    back = ssdr.load_skinning(path)
    assert (back.keyframes == small().skinning.keyframes).all()
    assert parsimony.size(back) == small().parsimony.size  # type: ignore[union-attr]
