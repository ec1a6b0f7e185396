"""Keys of a hierarchy: relative to the parent, a rotation alone where a joint is rigid."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import ssdr
from helpers.rig_tree import NAMES, PARENTS, POSITIONS, creature, flat
from ssdr.io.played_model import as_played
from ssdr.model.keyframes import Tracks
from ssdr.model.transforms import from_local

KINDS = [{}, {"loose": True}, {"scaled": True}]


def _tracks(model):
    return Tracks(model, np.array([0, model.n_frames]))


def _keys(model, bone, frames, value):
    """Every frame a key but for one bone, whose chosen frames alone have the value."""
    keys = np.ones(model.transforms.shape[:2], dtype=bool)
    keys[:, bone] = not value
    keys[frames, bone] = value
    return keys


def _added(tracks, model, keys):
    return float(((tracks.play(keys).skin() - model.skin()) ** 2).sum())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bone", range(len(PARENTS)))
def test_what_one_joint_costs_is_what_all_that_hangs_on_it_moves(kind, bone):
    model = creature(**kind).prune(1)
    tracks = _tracks(model)
    k = tracks.spans.index(3)
    for first in (0, 4):
        keys = _keys(model, bone, slice(first + 1, first + 3), False)
        added = _added(tracks, model, keys)
        assert tracks.cost[k][first, bone] == pytest.approx(added, rel=1e-7, abs=1e-12)
    costs = [
        _added(tracks, model, _keys(model, bone, frame, True)) for frame in range(model.n_frames)
    ]
    assert min(costs) == pytest.approx(costs[tracks.still[bone]], rel=1e-9, abs=1e-12)
    assert tracks.still_cost[bone] == pytest.approx(min(costs), rel=1e-7, abs=1e-10)


def test_shared_vertices_cost_at_most_what_is_said_of_one_joint():
    model = creature()
    tracks = _tracks(model)
    k = tracks.spans.index(3)
    for bone in range(model.n_bones):
        added = _added(tracks, model, _keys(model, bone, slice(3, 5), False))
        assert added <= tracks.cost[k][2, bone] * (1 + 1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_between_keys_joints_move_as_engines_move_them(kind):
    model = creature(**kind)
    tracks = _tracks(model)
    keys = np.zeros(model.transforms.shape[:2], dtype=bool)
    keys[[0, 4, 9]] = True
    keys[6, 1] = keys[2, 2] = True
    played = tracks.play(keys)
    local, before = played.local_transforms(), model.local_transforms()
    for b in range(model.n_bones):
        at = np.flatnonzero(keys[:, b])
        size = np.cbrt(np.linalg.det(before[:, b, :, :3]))
        turns = Rotation.from_matrix(before[at, b, :, :3] / size[at, None, None])
        linear = Slerp(at, turns)(np.arange(10)).as_matrix()
        linear = linear * np.interp(np.arange(10), at, size[at])[:, None, None]
        np.testing.assert_allclose(local[:, b, :, :3], linear, atol=1e-9)
        place = [np.interp(np.arange(10), at, before[at, b, c, 3]) for c in range(3)]
        np.testing.assert_allclose(local[:, b, :, 3], np.stack(place, axis=1), atol=1e-9)
    if not kind:
        assert played.joint_gaps().max() < 1e-12
    rig = as_played(played)
    np.testing.assert_array_equal(rig.keys, keys)
    np.testing.assert_allclose(rig.matrices(np.arange(10.0)), played.transforms, atol=1e-5)
    # where nothing above is between keys, to the last bit
    assert (played.transforms[[0, 4, 9]] == model.transforms[[0, 4, 9]]).all()


def test_an_elbow_that_turns_steadily_needs_two_keys_whatever_the_shoulder_does():
    model = creature(frames=12)
    local = model.local_transforms()
    foot = NAMES.index("foot")
    turn = Rotation.from_rotvec(np.outer(np.arange(12), [0.05, 0.02, 0.01])).as_matrix()
    local[:, foot, :, :3] = turn
    model = dataclasses.replace(model, transforms=from_local(local, np.array(PARENTS), POSITIONS))
    keys, _ = _tracks(model).choose(1e-7)
    assert np.flatnonzero(keys[:, foot]).tolist() == [0, 11]
    assert _tracks(flat(model)).choose(1e-7)[0][:, foot].sum() > 4


def test_size_by_hand():
    model = creature()
    size = ssdr.parsimony.size(model)
    free = ssdr.parsimony.size(flat(model))
    assert (size.rest, size.weights) == (free.rest, free.weights)
    assert size.joints == free.joints + 7
    assert size.keys == 10 * (2 * 28 + 5 * 16)
    assert free.keys == 10 * 7 * 28
    assert ssdr.parsimony.size(creature(loose=True)).keys == free.keys
    keys = np.zeros((10, 7), dtype=bool)
    keys[[0, 9]] = True
    keyed = dataclasses.replace(model, keyframes=keys)
    assert ssdr.parsimony.size(keyed).keys == 2 * (2 * 30 + 5 * 18)
    scaled = ssdr.parsimony.size(creature(scaled=True))
    assert scaled.keys == 10 * (2 * 32 + 5 * 20)
    affine = dataclasses.replace(model, bone_model="affine")
    assert ssdr.parsimony.size(affine).keys == 10 * (2 * 56 + 5 * 44)


def test_affine_joints_do_not_turn_over_between_keys():
    model = dataclasses.replace(creature(), bone_model="affine")
    local = model.local_transforms()
    local[6, 6, :, :3] = np.diag([-1.2, -0.8, 1])
    local[4, 6, :, :3] = np.eye(3)  # on the straight way to it is a reflection
    moved = from_local(local, np.array(PARENTS), POSITIONS)
    tracks = _tracks(dataclasses.replace(model, transforms=moved))
    keys, said = tracks.choose(1e-6)
    assert np.isfinite(said)
    assert (np.linalg.det(tracks.play(keys).transforms[..., :3]) > 0).all()
