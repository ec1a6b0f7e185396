"""Poses between frames, the way into the first pose, and what a motion refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

pytest.importorskip("zarr")

from garmentnet.data.motion import Motion, interpolate, lead_in
from garmentnet.data.skeleton import Skeleton
from garmentnet.scenes.body import default_body
from ssdr.common.errors import InputError

BODY = default_body()
TREE = BODY.skeleton


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_between_frames_limbs_keep_their_length(seed: int) -> None:
    rng = np.random.default_rng(seed)
    small = Skeleton(("a", "b", "c"), [-1, 0, 1], rng.normal(size=(3, 3)))
    turned = Rotation.random(9, random_state=rng).as_matrix().reshape(3, 3, 3, 3)
    joints = small.transforms(rng.normal(size=(3, 3)), turned)
    at = rng.uniform(0, 2, 7)
    between = interpolate(small, joints, at)
    p, q = small.positions(between), small.rest
    for a, b in ((0, 1), (1, 2)):
        np.testing.assert_allclose(
            np.linalg.norm(p[:, a] - p[:, b], axis=1), np.linalg.norm(q[a] - q[b]), rtol=1e-9
        )
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
    np.testing.assert_allclose(lead[0, 0, :, 1], [*Rotation.identity().apply([0, 1, 0])], atol=1e-9)
    heading = np.arctan2(lead[0, 0, 0, 2], lead[0, 0, 2, 2])
    np.testing.assert_allclose(heading, 2.0, atol=1e-9)


@pytest.mark.parametrize(
    "change",
    [
        {"joints": np.zeros((2, 3, 3, 3))},
        {"joints": np.full((2, 3, 3, 4), np.nan)},
        {"joints": np.zeros((2, 3, 3, 4))},
        {"joints": np.broadcast_to(np.diag([1.0, 1, -1, 0])[:3], (2, 3, 3, 4))},
        {"classes": [0]},
        {"classes": [0, 50]},
        {"fps": 0.0},
    ],
)
def test_motion_refuses(change: dict[str, Any]) -> None:
    good: dict[str, Any] = {
        "joints": np.broadcast_to(np.eye(3, 4), (2, 3, 3, 4)),
        "classes": [0, 0],
        **change,
    }
    with pytest.raises(InputError):
        Motion(**good)
