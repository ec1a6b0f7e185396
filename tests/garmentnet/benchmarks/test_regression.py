"""The baselines that regress offsets or positions, and the transformer for detail."""

# ruff: noqa: E402
import numpy as np
import pytest

torch = pytest.importorskip("torch")

import ssdr
from benchmarks.garment.published import BASELINES, SANTESTEBAN, train_chen
from benchmarks.garment.regression import FrameMLP, Unposed, WindowMLP, train_regression
from garmentnet.configs.config import override
from garmentnet.evaluation.baselines import BodySkinned, body_skinning
from garmentnet.evaluation.methods import Network
from garmentnet.networks.detail_basis import DetailBasis
from garmentnet.training.batches import load_tracks
from helpers.measures import pooled

TRAIN = [f"base-train-{k}" for k in range(8)]
HELD = ["base-validation-0", "base-validation-1"]


@pytest.mark.parametrize("part", ["whole", "low"])
def test_unposed_offsets_are_skinned(toy_bones, toy_store, part):
    space, s = Unposed(toy_bones), body_skinning(toy_store)
    rng = np.random.default_rng(0)
    offsets = (0.05 * rng.normal(size=(4, s.n_vertices, 3))).astype(np.float32)
    joints = toy_store.clip(TRAIN[0]).joints[20:24]
    got = space.add(offsets, joints, part)
    for t in range(4):
        expected = ssdr.skin(s.rest + offsets[t], s.indices, s.weights, joints[t])
        assert np.abs(got[t] - expected).max() < 1e-5
    assert np.abs(space.remove(got, joints, part) - offsets).max() < 1e-3


def test_unposed_detail_is_turned(toy_bones, toy_store):
    space = Unposed(toy_bones)
    rng = np.random.default_rng(0)
    detail = (0.01 * rng.normal(size=(3, toy_store.n_vertices, 3))).astype(np.float32)
    joints = toy_store.clip(TRAIN[0]).joints[20:23]
    moved = np.array(joints)
    moved[..., 3] += 7.0  # where the body stands plays no part
    got = space.remove(detail, moved, "high")
    assert np.abs(space.remove(detail, joints, "high") - got).max() < 1e-7
    assert np.abs(space.add(got, joints, "high") - detail).max() < 2e-4


def test_a_network_learns_and_goes_on(toy_bones, toy_store, toy_config, tmp_path):
    config = toy_config(epochs=12)
    learned = train_regression(SANTESTEBAN, toy_bones, config, TRAIN, HELD, tmp_path)
    clip = toy_store.clip("base-test-0")
    whole = clip.sequence.frames(slice(None))
    error = pooled(learned.predict(clip), whole)
    assert error < pooled(BodySkinned(toy_store).predict(clip), whole)
    again = train_regression(SANTESTEBAN, toy_bones, config, TRAIN, HELD, tmp_path)
    assert np.array_equal(again.predict(clip), learned.predict(clip))


@pytest.mark.parametrize("variant", BASELINES, ids=lambda v: v.name)
def test_published_baselines_are_better_than_nothing(
    toy_bones, toy_store, toy_config, tmp_path, variant
):
    found = train_regression(
        variant, toy_bones, toy_config(epochs=15), TRAIN[:4], HELD[:1], tmp_path
    )
    clip = toy_store.clip("base-test-0")
    low, high = found.split(clip, toy_bones)
    true_low, true_high = toy_bones.split(clip.name)
    still = np.broadcast_to(true_low.mean(axis=0), true_low.shape)
    assert pooled(low, true_low) < 0.8 * pooled(still, true_low)
    if "high" in variant.parts:
        assert pooled(high, true_high) < pooled(0 * high, true_high)
    else:
        assert not high.any()


@pytest.mark.parametrize("network", [FrameMLP, WindowMLP])
def test_whole_or_in_parts(network):
    torch.manual_seed(0)
    net, x = network(5, 8, 3), torch.randn(2, 20, 5)
    whole, _ = net(x)
    first, state = net(x[:, :7])
    second, _ = net(x[:, 7:], state)
    assert torch.allclose(whole, torch.cat([first, second], dim=1), atol=1e-6)
    # Neither sees the future; only one sees the past.
    changed = x.clone()
    changed[:, 9] += 1
    moved = (net(changed)[0] - whole).abs().amax((0, 2)) > 1e-6
    assert not moved[:9].any()
    assert bool(moved[10]) == (network is WindowMLP)


def test_transformer_detail(toy_bones, toy_store, toy_network, toy_config, tmp_path):
    network = toy_network.networks[0]
    config = override(network.config, ["high.kind=basis", "high.rank=8", "high.collision=0.0"])
    network_high, network_config = network.high, network.config
    try:
        network.config = config
        network.high = DetailBasis(
            network.low.code.mean.numel(), len(network.free), hidden=8, rank=8
        )
        tracks = load_tracks(network, toy_bones, TRAIN[:3])
        found = train_chen(toy_network, tracks, tracks[:1], tmp_path, hidden=16)
    finally:
        network.config, network.high = network_config, network_high
    assert isinstance(found, Network)
    clip = toy_store.clip(TRAIN[0])
    low, high = found.split(clip, toy_bones)
    assert np.abs(low - Network("", toy_network).split(clip, toy_bones)[0]).max() < 1e-6
    truth = toy_bones.split(clip.name)[1]
    assert pooled(high, truth) < pooled(0 * high, truth)
