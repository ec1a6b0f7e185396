"""A prediction as a skinned model with morph targets, read back by the glTF reader."""

import numpy as np
import pytest

pytest.importorskip("torch")

import ssdr
from garmentnet.data.parameters import SimulationParameters as P
from garmentnet.networks.checkpoint import Checkpoint
from garmentnet.prediction.prediction import predict
from garmentnet.prediction.rigged import rigged, save_rigged
from helpers import live_garment as made
from ssdr.common.errors import InputError


@pytest.fixture(scope="module")
def checkpoint():
    return Checkpoint((made.network(),), (P(),), None)


@pytest.fixture(scope="module")
def result(checkpoint):
    return predict(checkpoint, made.motion(2.0, seed=3), push_out=False)


def test_the_file_plays_the_prediction(result, tmp_path):
    model = rigged(result, made.skeleton(), shapes=5)  # the network has five components
    assert model.error < 0.2 * model.still
    assert (model.skinning.shapes.amounts.min(axis=0) > -1e-6).all()
    assert (model.skinning.shapes.amounts.max(axis=0) < 1 + 1e-6).all()
    text = save_rigged(model, tmp_path / "dress.glb")
    assert "15 joints, 5 morph targets, 60 frames" in text
    gap = ssdr.load(tmp_path / "dress.glb").vertices - result.cloth.vertices
    assert np.sqrt((gap**2).sum(-1).mean()) == pytest.approx(model.error, rel=1e-2)
    errors = [rigged(result, made.skeleton(), shapes=k).error for k in (1, 3, 60)]
    assert errors[0] > errors[1] > model.error > errors[2]
    assert errors[2] < 1e-5
    with pytest.raises(InputError, match="shapes"):
        rigged(result, made.skeleton(), shapes=0)


def test_joints_are_the_bodys(result):
    model = rigged(result, made.skeleton()).skinning.skinning
    assert model.bone_names[:6] == made.skeleton().names
    assert model.parents[:6].tolist() == made.skeleton().parents.tolist()
    assert set(model.parents[6:].tolist()) == {0}
    np.testing.assert_array_equal(model.transforms[:, :6], result.joints)
