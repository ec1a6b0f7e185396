"""A GRU of which the mirror image of a motion exchanges the halves of the state."""

# ruff: noqa: E402

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from benchmarks.garment.scenes.body import default_body
from benchmarks.garment.scenes.dance.choreography import dance
from garmentnet.configs.config import load_config, override
from garmentnet.data.skeleton import mirror_transforms
from garmentnet.networks.checkpoint import load_checkpoint
from garmentnet.networks.features import Normaliser, PoseFeatures, PoseReader
from garmentnet.networks.gru import GRU
from garmentnet.networks.symmetry import reflected_inputs, tie_mirrored
from garmentnet.training.run import train
from ssdr.common.errors import InputError


def _reader(preset, skeleton, condition=0, **change):
    options = dataclasses.replace(load_config(preset).features, **change)
    features = PoseFeatures(skeleton, options, 30.0)
    still = Normaliser(np.zeros(features.size), np.ones(features.size), 0.0)
    return PoseReader(features, still, condition)


@pytest.mark.parametrize("preset", ["rooted", "faithful", "tiny"])
def test_inputs_of_a_mirrored_motion(preset):
    skeleton = default_body().skeleton
    reader = _reader(preset, skeleton, condition=3)
    joints = dance(skeleton, seed=3, frames=40).joints
    image = mirror_transforms(joints, skeleton.mirror())
    x, y = (reader.inputs(reader.features(j)[0], [0.1, 0.2, 0.3]) for j in (joints, image))
    columns, signs = reflected_inputs(reader)
    np.testing.assert_allclose(x[:, columns] * signs, y, atol=1e-6)
    assert (signs < 0).any()
    assert (columns != np.arange(len(columns))).any()
    assert signs[-3:].tolist() == [1, 1, 1]


def test_joints_of_one_side():
    reader = _reader("rooted", default_body().skeleton, joints=("pelvis", "thigh_l"))
    with pytest.raises(InputError, match=r"features\.joints"):
        reflected_inputs(reader)


def _states(gru, x, columns, signs):
    """States of a motion, and those of its mirror image with their halves exchanged."""
    with torch.no_grad():
        h, image = (gru(torch.from_numpy(part)[None])[0][0] for part in (x, x[:, columns] * signs))
    return h.numpy(), torch.cat(image.chunk(2, dim=1)[::-1], dim=1).numpy()


def test_states_mirror_each_other_before_and_after_training():
    rng = np.random.default_rng(0)
    columns, signs = np.array([1, 0, 2, 3, 4]), np.array([1, 1, -1, 1, -1], np.float32)
    x = rng.normal(size=(30, 5)).astype(np.float32)
    torch.manual_seed(0)
    gru = GRU(5, 8)
    free = _states(gru, x, columns, signs)
    assert np.abs(free[0] - free[1]).max() > 0.1
    size = float(gru.weight_hh_l0.detach().norm())
    tie_mirrored(gru, columns, signs)
    assert float(gru.weight_hh_l0.detach().norm()) == pytest.approx(size)
    before = [p.detach().clone() for p in gru.parameters()]
    optimiser = torch.optim.Adam(gru.parameters(), lr=0.05)
    for _ in range(5):
        optimiser.zero_grad()
        torch.autograd.backward((gru(torch.from_numpy(x)[None])[0] - 0.3).square().sum())
        optimiser.step()
    after = list(gru.parameters())
    assert all(not torch.allclose(a, b) for a, b in zip(before, after, strict=True))
    h, image = _states(gru, x, columns, signs)
    np.testing.assert_allclose(image, h, atol=1e-6)
    # Weights that are tied already stay as they are, as where a training goes on.
    tied = [p.detach().clone() for p in after]
    tie_mirrored(gru, columns, signs)
    for a, b in zip(tied, gru.parameters(), strict=True):
        torch.testing.assert_close(b.detach(), a, rtol=1e-6, atol=1e-7)


def test_a_trained_network_is_symmetric(toy_config, toy_store, tmp_path):
    config = override(toy_config(epochs=3, high_epochs=0), ["low.symmetric=true"])
    (network,) = load_checkpoint(train(toy_store, config, tmp_path)).networks
    assert network.config.low.symmetric
    assert load_config("rooted").low.symmetric
    columns, signs = reflected_inputs(network)
    joints = toy_store.clip(toy_store.names()[0]).joints
    x = network.inputs(network.features(joints)[0])
    h, image = _states(network.low.gru, x, columns, signs)
    np.testing.assert_allclose(image, h, atol=2e-5)
