"""Poses of a skeleton and their mirror images."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("zarr")

from garmentnet.data.skeleton import REFLECTION, Skeleton, mirror_transforms
from ssdr.errors import InputError
from ssdr.rigid import matrix_from_quaternion

NAMES = ("pelvis", "thigh_l", "thigh_r")
PARENTS = np.array([-1, 0, 0])
HEADS = np.array([[0.0, 1.0, 0.0], [0.1, 0.9, 0.0], [-0.1, 0.9, 0.0]])


def skeleton() -> Skeleton:
    return Skeleton(NAMES, PARENTS, HEADS)


def random_pose(rng: np.random.Generator, frames: int) -> np.ndarray:
    rotations = matrix_from_quaternion(rng.normal(size=(frames, 3, 4)))
    return skeleton().transforms(rng.normal(size=(frames, 3)), rotations)


def test_pose_undoes_transforms(rng: np.random.Generator) -> None:
    joints = random_pose(rng, 6)
    root, rotations = skeleton().pose(joints)
    np.testing.assert_allclose(skeleton().transforms(root, rotations), joints, atol=1e-12)
    still = skeleton().transforms(HEADS[:1], np.eye(3)[None, None].repeat(3, 1))
    np.testing.assert_allclose(still, np.eye(3, 4)[None, None].repeat(3, 1), atol=1e-12)


def test_mirror_is_a_conjugation(rng: np.random.Generator) -> None:
    joints = random_pose(rng, 4)
    swap = skeleton().mirror()
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
    given: dict[str, Any] = {"names": NAMES, "parents": PARENTS, "rest": HEADS, **change}
    with pytest.raises(InputError):
        Skeleton(**given)
