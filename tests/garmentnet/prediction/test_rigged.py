"""A prediction as a skinned model, read back by the glTF reader."""

import re

import numpy as np
import pytest

import ssdr
from garmentnet.data.parameters import SimulationParameters as P
from garmentnet.networks.checkpoint import Checkpoint
from garmentnet.prediction.output import save_prediction
from garmentnet.prediction.prediction import predict
from helpers import live_garment as made


@pytest.fixture(scope="module")
def checkpoint():
    return Checkpoint((made.network(),), (P(),), None)


@pytest.fixture(scope="module")
def result(checkpoint):
    return predict(checkpoint, made.motion(2.0, seed=3), push_out=False)


def test_the_file_plays_the_bones_and_says_what_they_lack(result, tmp_path):
    text = save_prediction(result, tmp_path / "dress.glb")
    gap = ssdr.load(tmp_path / "dress.glb").vertices - result.cloth.vertices
    error = f"{1e3 * np.sqrt((gap**2).sum(-1).mean()):.1f}"
    assert re.search(rf"15 joints, 60 frames, .* prediction {error}", text)


def test_joints_are_the_bodys(result):
    model = result.skinning
    assert model.bone_names[:6] == made.skeleton().names
    assert model.parents[:6].tolist() == made.skeleton().parents.tolist()
    assert set(model.parents[6:].tolist()) == {0}
    np.testing.assert_array_equal(model.transforms[:, :6], result.joints)
