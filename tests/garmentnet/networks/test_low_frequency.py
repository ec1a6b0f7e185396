"""Bones as numbers and back."""

# ruff: noqa: E402

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from scipy.spatial.transform import Rotation

from garmentnet.networks.low_frequency import BoneCode


@pytest.mark.parametrize("rotation", ["euler", "sixd"])
def test_bone_code_round_trip(rotation):
    rng = np.random.default_rng(0)
    m = np.concatenate(
        [
            Rotation.random(60, rng=rng).as_matrix().reshape(12, 5, 3, 3),
            rng.normal(size=(12, 5, 3, 1)),
        ],
        axis=-1,
    )
    code = BoneCode(rng.normal(size=(5, 3)), rotation)
    code.fit(m)
    numbers = torch.from_numpy(code.numbers(m)).float()
    z = (numbers - code.mean) / code.deviation
    assert np.abs(code(z).numpy() - m).max() < 2e-5
    # Zero is the mean motion, and the translation is that of the bone's centre.
    assert np.allclose(
        code.numbers(code(0 * z).double().numpy())[0][:, -3:], code.mean[:, -3:], atol=1e-5
    )
