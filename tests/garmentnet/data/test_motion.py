"""Poses of a skeleton, between frames and mirrored; parameters; what each of them refuses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.garment.scenes.body import default_body
from benchmarks.garment.scenes.motion import Motion, interpolate
from benchmarks.garment.scenes.simulator import lead_in
from garmentnet.data.parameters import RANGES, SimulationParameters
from garmentnet.data.skeleton import Skeleton, mirror_transforms
from helpers import toy_store as toy
from ssdr.common.errors import InputError

TREE = default_body().skeleton
_, SMALL = toy.body()


def test_pose_undoes_transforms(rng: np.random.Generator) -> None:
    joints = toy.random_pose(rng, SMALL, 6)
    root, rotations = SMALL.pose(joints)
    np.testing.assert_allclose(SMALL.transforms(root, rotations), joints, atol=1e-12)
    still = SMALL.transforms(SMALL.rest[:1], np.eye(3)[None, None].repeat(3, 1))
    np.testing.assert_allclose(still, np.eye(3, 4)[None, None].repeat(3, 1), atol=1e-12)


def test_mirror_is_a_conjugation(rng: np.random.Generator) -> None:
    joints = toy.random_pose(rng, SMALL, 4)
    swap = SMALL.mirror()
    np.testing.assert_array_equal(swap, [0, 2, 1])
    s = np.diag([-1.0, 1.0, 1.0, 1.0])
    for t in range(4):
        for j in range(3):
            m = np.vstack([joints[t, swap[j]], [0, 0, 0, 1]])
            np.testing.assert_allclose(mirror_transforms(joints, swap)[t, j], (s @ m @ s)[:3])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_between_frames_limbs_keep_their_length(seed: int) -> None:
    rng = np.random.default_rng(seed)
    small = Skeleton(("a", "b", "c"), [-1, 0, 1], rng.normal(size=(3, 3)))
    turned = Rotation.random(9, random_state=rng).as_matrix().reshape(3, 3, 3, 3)
    joints = small.transforms(rng.normal(size=(3, 3)), turned)
    at = rng.uniform(0, 2, 7)
    p, q = small.positions(interpolate(small, joints, at)), small.rest
    for a, b in ((0, 1), (1, 2)):
        length = np.linalg.norm(p[:, a] - p[:, b], axis=1)
        np.testing.assert_allclose(length, np.linalg.norm(q[a] - q[b]), rtol=1e-9)
    np.testing.assert_allclose(interpolate(small, joints, np.arange(3)), joints, atol=1e-9)


def test_lead_in_begins_at_rest_and_ends_in_the_pose(rng: np.random.Generator) -> None:
    turned = np.broadcast_to(np.eye(3), (1, TREE.n_joints, 3, 3)).copy()
    turned[0, 0] = Rotation.from_euler("YX", [2.0, 0.3]).as_matrix()
    turned[0, 3] = Rotation.random(random_state=rng).as_matrix()
    pose = TREE.transforms(np.array([[1.0, 0.8, -2.0]]), turned)
    lead = lead_in(TREE, pose, 10, 5)
    assert lead.shape == (15, TREE.n_joints, 3, 4)
    np.testing.assert_allclose(lead[10:], np.repeat(pose, 5, axis=0), atol=1e-12)
    # Rigid in the first frame: the garment is set down as it was cut.
    np.testing.assert_allclose(lead[0], np.repeat(lead[0, :1], TREE.n_joints, axis=0), atol=1e-9)
    np.testing.assert_allclose(lead[0, 0, :, 1], [0, 1, 0], atol=1e-9)
    heading = np.arctan2(lead[0, 0, 0, 2], lead[0, 0, 2, 2])
    np.testing.assert_allclose(heading, 2.0, atol=1e-9)


def test_parameters_normalise_to_their_ranges() -> None:
    for share in (-1, 0, 1):
        between = {
            n: a ** ((1 - share) / 2) * b ** ((1 + share) / 2) for n, (a, b) in RANGES.items()
        }
        found = SimulationParameters(**between).normalised()
        np.testing.assert_allclose(found, share, atol=1e-12)


def skeleton(**change: Any) -> Skeleton:
    given = {"names": SMALL.names, "parents": SMALL.parents, "rest": SMALL.rest}
    return Skeleton(**(given | change))


def motion(joints: Any = None, classes: Any = (0, 0), **change: Any) -> Motion:
    still = np.broadcast_to(np.eye(3, 4), (2, 3, 3, 4))
    return Motion(still if joints is None else joints, classes, **change)


BROKEN = np.tile(np.eye(3, 4), (5, 3, 1, 1))
BROKEN[3, 1, 0, 0] = np.nan
REFUSED: list[tuple[Callable[..., object], str, Any, str]] = [
    (skeleton, "names", ("a", "a", "b"), "names"),
    (skeleton, "parents", [-1, 1, 0], "parents"),
    (skeleton, "parents", [0, 0, 0], "parents"),
    (skeleton, "rest", np.zeros((2, 3)), "rest"),
    (skeleton, "rest", np.full((3, 3), np.nan), "rest"),
    (motion, "joints", np.zeros((2, 3, 3, 3)), "joints: .*shape"),
    (motion, "joints", np.zeros((0, 3, 3, 4)), "joints: .*shape"),
    (motion, "joints", BROKEN, "frame 3, joint 1"),
    (motion, "joints", np.zeros((2, 3, 3, 4)), "rigid"),
    (motion, "joints", np.broadcast_to(np.diag([1.0, 1, -1, 0])[:3], (2, 3, 3, 4)), "rigid"),
    (motion, "classes", [0], "classes"),
    (motion, "classes", [0, 50], "classes"),
    (motion, "fps", 0.0, "fps"),
    *((SimulationParameters, "density", v, "density") for v in (0, -1, np.nan, np.inf, "1", True)),
    (SimulationParameters, "bending", None, "bending"),
]


@pytest.mark.parametrize(("make", "argument", "value", "text"), REFUSED)
def test_refusals(make: Callable[..., object], argument: str, value: Any, text: str) -> None:
    with pytest.raises(InputError, match=text):
        make(**{argument: value})
