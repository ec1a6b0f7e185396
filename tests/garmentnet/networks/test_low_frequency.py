"""Bones as numbers and back."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from garmentnet.paper.low import BoneCode


def rigid(rng, *shape):
    turns = Rotation.random(int(np.prod(shape)), rng=rng).as_matrix().reshape(*shape, 3, 3)
    return np.concatenate([turns, rng.normal(size=(*shape, 3, 1))], axis=-1)


@pytest.mark.parametrize("rotation", ["euler", "sixd"])
def test_bone_code_round_trip(rotation):
    rng = np.random.default_rng(0)
    m = rigid(rng, 12, 5)
    code = BoneCode(rng.normal(size=(5, 3)), rotation)
    code.fit(m)
    numbers = torch.from_numpy(code.numbers(m)).float()
    z = (numbers - code.mean) / code.deviation
    assert np.abs(code(z).numpy() - m).max() < 2e-5
    # Zero is the mean motion, and the translation is that of the bone's centre.
    assert np.allclose(
        code.numbers(code(0 * z).double().numpy())[0][:, -3:], code.mean[:, -3:], atol=1e-5
    )


@pytest.mark.parametrize("rotation", ["euler", "sixd"])
def test_bones_that_follow_joints(rotation):
    rng = np.random.default_rng(1)
    joints, still = rigid(rng, 12, 2), rigid(rng, 3)
    # Two bones hang on the joints, one on nothing.
    base = np.concatenate([joints, np.tile(np.eye(3, 4), (12, 1, 1, 1))], axis=1)
    turn = base[..., :3] @ still[..., :3]
    place = base[..., :3] @ still[..., 3:] + base[..., 3:]
    m = np.concatenate([turn, place], axis=-1)[:, [1, 2, 0]]
    code = BoneCode(rng.normal(size=(3, 3)), rotation, follows=True)
    code.fit(m, joints)
    assert code.followed.tolist() == [1, -1, 0]
    numbers = code.numbers(m, joints)
    assert np.ptp(numbers, axis=0).max() < 1e-9  # nothing is left to learn
    z = torch.zeros(1, 12, *code.shape)
    assert np.abs(code(z, torch.from_numpy(joints).float()[None])[0].numpy() - m).max() < 2e-5
