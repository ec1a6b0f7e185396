# ruff: noqa: E402
import numpy as np
import pytest

torch = pytest.importorskip("torch")

import ssdr
from garmentnet.evaluation.baselines import BodySkinned, MeanShape, Ridge, body_skinning
from garmentnet.evaluation.santesteban import Santesteban, train_santesteban

TRAIN = [f"base-train-{k}" for k in range(8)]
HELD = ["base-validation-0", "base-validation-1"]


def rmse(a, b):
    return float(np.sqrt(((a - b) ** 2).sum(-1).mean()))


def test_mean_shape_is_the_best_fixed_shape(toy_bones, toy_store):
    clip = toy_store.clip(TRAIN[0])
    whole = clip.sequence.frames(slice(None))
    mean = MeanShape(toy_bones, [TRAIN[0]])
    best = rmse(mean.predict(clip.joints), whole)
    rng = np.random.default_rng(0)
    for _ in range(3):
        mean.shape = mean.shape + 5e-3 * rng.normal(size=mean.shape.shape)
        assert rmse(mean.predict(clip.joints), whole) > best


def test_body_skinned_is_the_rest_pose_at_rest(toy_store):
    rest = np.tile(np.eye(3, 4), (1, 3, 1, 1))
    assert np.abs(BodySkinned(toy_store).predict(rest)[0] - toy_store.rest).max() < 1e-6
    s = body_skinning(toy_store)
    assert np.allclose(s.weights.sum(axis=1), 1)
    # The hem hangs where the legs are, the waist at the root.
    dense = s.dense_weights()
    assert dense[:16, 0].mean() > dense[-16:, 0].mean()


def test_ridge_finds_a_linear_rule(toy_bones, toy_store):
    # Bones that follow the pose at once: what a static regression can tell exactly.
    import copy

    fake = copy.copy(toy_bones)
    kept = {n: toy_bones.clip(n) for n in (*TRAIN[:3], *HELD)}
    import dataclasses

    def posed(name):
        joints = toy_store.clip(name).joints
        moved = np.repeat(joints[:, :1], toy_bones.skinning.n_bones, axis=1)
        return dataclasses.replace(kept[name], transforms=moved.astype(np.float32))

    object.__setattr__(fake, "clip", posed)
    ridge = Ridge(fake, TRAIN[:3], HELD)
    ridge.high = 0 * ridge.high
    s = toy_bones.skinning
    expected = ssdr.skin(s.rest, s.joints, s.weights, posed(HELD[0]).transforms)
    assert rmse(ridge.predict(toy_store.clip(HELD[0]).joints), expected) < 5e-3


def test_santesteban_offsets_then_poses(toy_bones, toy_store, toy_network):
    module = Santesteban(toy_network.networks[0], toy_store, 16)
    s = body_skinning(toy_store)
    rng = np.random.default_rng(0)
    offsets = (0.05 * rng.normal(size=(4, s.n_vertices, 3))).astype(np.float32)
    joints = toy_store.clip(TRAIN[0]).joints[20:24]
    got = module.pose(torch.from_numpy(offsets), torch.from_numpy(joints)).detach().numpy()
    for t in range(4):
        expected = ssdr.skin(s.rest + offsets[t], s.joints, s.weights, joints[t])
        assert np.abs(got[t] - expected).max() < 1e-5


def test_santesteban_learns_and_goes_on(toy_bones, toy_store, toy_config, tmp_path):
    config = toy_config(epochs=12)
    module = train_santesteban(toy_bones, config, TRAIN, HELD, tmp_path)
    clip = toy_store.clip("base-test-0")
    whole = clip.sequence.frames(slice(None))
    learned = rmse(module.predict(clip.joints), whole)
    assert learned < rmse(BodySkinned(toy_store).predict(clip.joints), whole)
    again = train_santesteban(toy_bones, config, TRAIN, HELD, tmp_path)
    assert np.array_equal(again.predict(clip.joints), module.predict(clip.joints))


def test_exact_offsets_are_the_statistics(toy_bones, toy_store, toy_config):
    from garmentnet.evaluation.santesteban import SantestebanObjective
    from garmentnet.training.batches import load_tracks
    from garmentnet.training.run import build_network

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
    assert rmse(mean.numpy(), truth.numpy()) < rmse(none.numpy(), truth.numpy())
