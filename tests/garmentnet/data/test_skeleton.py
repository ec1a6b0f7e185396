"""Poses of a skeleton and their mirror images."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("zarr")

from garmentnet.data.skeleton import REFLECTION, Skeleton, mirror_transforms
from helpers import toy_store as toy
from ssdr.common.errors import InputError

_, SKELETON = toy.body()


def test_pose_undoes_transforms(rng: np.random.Generator) -> None:
    joints = toy.random_pose(rng, SKELETON, 6)
    root, rotations = SKELETON.pose(joints)
    np.testing.assert_allclose(SKELETON.transforms(root, rotations), joints, atol=1e-12)
    still = SKELETON.transforms(SKELETON.rest[:1], np.eye(3)[None, None].repeat(3, 1))
    np.testing.assert_allclose(still, np.eye(3, 4)[None, None].repeat(3, 1), atol=1e-12)


def test_mirror_is_a_conjugation(rng: np.random.Generator) -> None:
    joints = toy.random_pose(rng, SKELETON, 4)
    swap = SKELETON.mirror()
    np.testing.assert_array_equal(swap, [0, 2, 1])
    s = np.eye(4)
    s[:3, :3] = REFLECTION
    for t in range(4):
        for j in range(3):
            m = np.vstack([joints[t, swap[j]], [0, 0, 0, 1]])
            np.testing.assert_allclose(mirror_transforms(joints, swap)[t, j], (s @ m @ s)[:3])


@pytest.mark.parametrize(
    "change",
    [
        {"names": ("a", "a", "b")},
        {"parents": [-1, 1, 0]},
        {"parents": [0, 0, 0]},
        {"rest": np.zeros((2, 3))},
        {"rest": np.full((3, 3), np.nan)},
    ],
)
def test_skeleton_refuses(change: dict[str, Any]) -> None:
    given: dict[str, Any] = {
        "names": SKELETON.names,
        "parents": SKELETON.parents,
        "rest": SKELETON.rest,
        **change,
    }
    with pytest.raises(InputError):
        Skeleton(**given)
