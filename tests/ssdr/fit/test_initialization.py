"""`initialize`: a bone for each moving part, as many as asked."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import motions


def test_separate_bodies_get_a_bone_each() -> None:
    rig = motions.boxes(6)
    found = ssdr.initialize(rig.frames, bones=6)
    assert found.n_bones == 6
    assert np.abs(found.skin() - rig.frames).max() < 1e-6
    owner = found.indices[:, 0].reshape(6, -1)
    assert (owner == owner[:, :1]).all()
    assert len(set(owner[:, 0])) == 6


@pytest.mark.parametrize("bones", [1, 3, 120])
def test_as_many_bones_as_asked(bones: int) -> None:
    rig = motions.chain()
    found = ssdr.initialize(rig.frames, rig.faces, bones=bones, influences=3)
    assert found.n_bones == bones
    assert found.weights.shape == (120, min(3, bones))
    assert np.abs(found.weights.sum(axis=1) - 1).max() < 1e-9
    r = found.transforms[..., :3]
    assert np.abs(np.einsum("tjca,tjcb->tjab", r, r) - np.eye(3)).max() < 1e-6
    assert np.linalg.det(r).min() > 0


def test_static_mesh_keeps_the_number() -> None:
    rig = motions.chain(frames=1)
    found = ssdr.initialize(np.repeat(rig.frames, 5, axis=0), bones=20)
    assert found.n_bones == 20
    assert np.abs(found.skin() - rig.frames).max() < 1e-6


def test_given_rest_pose_stays() -> None:
    rig = motions.chain()
    frames = motions.wobble(rig, 0.2)
    found = ssdr.initialize(frames, bones=6, rest=frames[3])
    assert np.abs(found.rest - frames[3]).max() < 1e-9


def test_seed_decides() -> None:
    rig = motions.chain()
    frames = motions.wobble(rig, 0.2)
    one, same = (ssdr.initialize(frames, bones=6, rng=4) for _ in range(2))
    other = ssdr.initialize(frames, bones=6, rng=5)
    assert np.array_equal(one.transforms, same.transforms)
    assert not np.array_equal(one.transforms, other.transforms)
