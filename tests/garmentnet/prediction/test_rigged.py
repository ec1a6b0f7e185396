"""A prediction as a skinned model with morph targets, read back by the glTF reader."""

import numpy as np
import pytest

pytest.importorskip("torch")

import ssdr
from garmentnet.data.parameters import SimulationParameters as P
from garmentnet.networks.checkpoint import Checkpoint
from garmentnet.prediction.morph_targets import with_morph_targets
from garmentnet.prediction.output import save_prediction
from garmentnet.prediction.prediction import predict
from helpers import live_garment as made


@pytest.fixture(scope="module")
def checkpoint():
    return Checkpoint((made.network(),), (P(),), None)


@pytest.fixture(scope="module")
def result(checkpoint):
    return predict(checkpoint, made.motion(2.0, seed=3), push_out=False)


def test_the_file_plays_the_prediction(result, tmp_path):
    errors = []
    for count in (0, 1, 3, 5, 60):  # the network has five components
        text = save_prediction(result, tmp_path / "dress.glb", shapes=count)
        gap = ssdr.load(tmp_path / "dress.glb").vertices - result.cloth.vertices
        errors.append(np.sqrt((gap**2).sum(-1).mean()))
        if count == 5:
            assert "15 joints, 5 morph targets, 60 frames" in text
            assert f"{1e3 * errors[-1]:.1f}"[:3] in text
    assert errors == sorted(errors, reverse=True)
    assert errors[3] < 0.2 * errors[0]
    assert errors[4] < 1e-5
    amounts = with_morph_targets(result.skinning, result.cloth.vertices, 5).shapes.amounts
    assert amounts.min() > -1e-6
    assert amounts.max() < 1 + 1e-6


def test_joints_are_the_bodys(result):
    model = result.skinning
    assert model.bone_names[:6] == made.skeleton().names
    assert model.parents[:6].tolist() == made.skeleton().parents.tolist()
    assert set(model.parents[6:].tolist()) == {0}
    np.testing.assert_array_equal(model.transforms[:, :6], result.joints)
