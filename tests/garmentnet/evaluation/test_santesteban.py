"""The recurrent baseline."""

# ruff: noqa: E402
import numpy as np
import pytest

torch = pytest.importorskip("torch")

import ssdr
from garmentnet.evaluation.baselines import BodySkinned, body_skinning
from garmentnet.evaluation.santesteban import Santesteban, SantestebanObjective, train_santesteban
from garmentnet.training.batches import load_tracks
from garmentnet.training.run import build_network
from helpers.measures import pooled

TRAIN = [f"base-train-{k}" for k in range(8)]
HELD = ["base-validation-0", "base-validation-1"]


def test_santesteban_offsets_then_poses(toy_bones, toy_store, toy_network):
    module = Santesteban(toy_network.networks[0], toy_store, 16)
    s = body_skinning(toy_store)
    rng = np.random.default_rng(0)
    offsets = (0.05 * rng.normal(size=(4, s.n_vertices, 3))).astype(np.float32)
    joints = toy_store.clip(TRAIN[0]).joints[20:24]
    got = module.pose(torch.from_numpy(offsets), torch.from_numpy(joints)).detach().numpy()
    for t in range(4):
        expected = ssdr.skin(s.rest + offsets[t], s.indices, s.weights, joints[t])
        assert np.abs(got[t] - expected).max() < 1e-5


def test_santesteban_learns_and_goes_on(toy_bones, toy_store, toy_config, tmp_path):
    config = toy_config(epochs=12)
    module = train_santesteban(toy_bones, config, TRAIN, HELD, tmp_path)
    clip = toy_store.clip("base-test-0")
    whole = clip.sequence.frames(slice(None))
    learned = pooled(module.predict(clip), whole)
    assert learned < pooled(BodySkinned(toy_store).predict(clip), whole)
    again = train_santesteban(toy_bones, config, TRAIN, HELD, tmp_path)
    assert np.array_equal(again.predict(clip), module.predict(clip))


def test_exact_offsets_are_the_statistics(toy_bones, toy_store, toy_config):

    reader = build_network(toy_config(), toy_bones, TRAIN[:1])
    module = Santesteban(reader, toy_store, 8)
    tracks = load_tracks(reader, toy_bones, TRAIN[:1])
    task = SantestebanObjective(module, tracks, tracks)
    task.fit_statistics()
    # The mean offset beats none.
    joints, truth = tracks[0].joints(), tracks[0].target("low") + tracks[0].target("high")
    with torch.no_grad():
        mean = module.pose(module.mean.expand(len(joints), -1, -1), joints)
        none = module.pose(torch.zeros_like(mean), joints)
    assert pooled(mean.numpy(), truth.numpy()) < pooled(none.numpy(), truth.numpy())
