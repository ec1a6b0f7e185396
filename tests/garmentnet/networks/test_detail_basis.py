"""The detail basis: its algebra, its module in a network, and what it learns."""

import dataclasses

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from garmentnet.networks.detail_basis import DetailBasis
from garmentnet.paper.bones import TorchSkinning, surface_frame, turn, turn_back
from garmentnet.training.batches import batches, load_tracks
from garmentnet.training.detail import DetailObjective


def test_turns_are_the_bones_rotations_where_one_bone_rules():
    rng = np.random.default_rng(0)
    rotations = Rotation.random(6, random_state=0).as_matrix().reshape(2, 3, 3, 3)
    transforms = np.concatenate([rotations, rng.normal(size=(2, 3, 3, 1))], axis=-1)
    lbs = TorchSkinning(np.zeros((3, 3)), [[0, 1], [2, 0], [1, 2]], [[1, 0], [1, 0], [0.5, 0.5]], 3)
    blend = lbs.blend(torch.from_numpy(transforms).float())
    got = torch.stack(surface_frame(blend), dim=-1).transpose(-2, -3).numpy()
    local = torch.from_numpy(rng.normal(size=(2, 3, 3))).float()
    turned = turn(blend, local)
    np.testing.assert_allclose(turned, (got @ local.numpy()[..., None])[..., 0], atol=1e-5)
    np.testing.assert_allclose(turn_back(blend, turned), local, atol=1e-5)
    np.testing.assert_allclose(got[:, 0], rotations[:, 0], atol=1e-6)
    np.testing.assert_allclose(got[:, 1], rotations[:, 2], atol=1e-6)
    product = got @ got.swapaxes(-1, -2)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-5)
    np.testing.assert_allclose(np.linalg.det(got), 1, atol=1e-5)


def test_components_are_the_principal_ones():
    rng = np.random.default_rng(0)
    frames = rng.normal(size=(40, 5, 3)) * np.linspace(3, 0.1, 15).reshape(5, 3) + 7
    module = DetailBasis(4, 5, hidden=3, rank=6)
    module.fit(torch.from_numpy(frames).float())
    flat = (frames - frames.mean(0)).reshape(40, -1)
    values = np.linalg.svd(flat, compute_uv=False)
    numbers, rest = module.code(torch.from_numpy(frames).float())
    np.testing.assert_allclose(rest.sum(), (values[6:] ** 2).sum(), rtol=1e-4)
    np.testing.assert_allclose(module.deviation.numpy(), values[:6] / np.sqrt(40), rtol=1e-4)
    again = module.local(numbers).numpy()
    np.testing.assert_allclose(((again - frames) ** 2).sum((1, 2)), rest.numpy(), atol=1e-3)
    gram = module.basis @ module.basis.T
    np.testing.assert_allclose(gram.numpy(), np.eye(6), atol=1e-5)


@torch.no_grad()
def test_what_the_low_frequencies_leave(toy_basis, toy_store, toy_bones):
    """With that target the error is the garment's."""
    network, name = toy_basis.networks[0], "base-train-0"
    before = network.config
    network.config = dataclasses.replace(
        before, high=dataclasses.replace(before.high, target="residual")
    )
    try:
        tracks = load_tracks(network, toy_bones, [name])
        error = DetailObjective(network, [], tracks, start=True).validate()
    finally:
        network.config = before
    gap = network.predict(toy_store.clip(name).joints) - toy_store.clip(name).sequence.frames(
        slice(None)
    )
    expected = float(np.sqrt((gap[:, network.free] ** 2).sum(-1).mean()))
    assert abs(error - expected) < 1e-4 * expected


@torch.no_grad()
def test_the_loss_is_that_of_the_mesh(toy_basis, toy_store, toy_bones):
    network = toy_basis.networks[0]
    name = "base-train-0"
    tracks = load_tracks(network, toy_bones, [name])
    task = DetailObjective(network, tracks, tracks, start=True)
    motion, _ = network.run(toy_store.clip(name).joints)
    gap = (motion.high - tracks[0].detail())[:, network.free]
    each = gap.square().sum(-1).mean(-1)
    assert abs(task.validate() - float(each.mean().sqrt())) < 1e-5 * task.validate()
    # Without dropout the loss is the mean of the frames' RMSE.
    task.dropout = 0.0
    losses = []
    state = None
    for batch in batches(task.tracks, 1, 30, None):
        loss, state = task.loss(batch, batch.forget(state), np.random.default_rng(0))
        losses.append(float(loss) * int(batch.mask.sum()))
    mean = float(each.sqrt().mean())
    assert abs(sum(losses) / len(each) - mean) < 1e-3 * mean


@torch.no_grad()
def test_it_beats_the_mean_detail(toy_basis, toy_bones):
    network = toy_basis.networks[0]
    tracks = load_tracks(network, toy_bones, ["base-validation-0"])
    task = DetailObjective(network, [], tracks, start=True)
    learned = task.validate()
    network.high.deviation.zero_()
    assert learned < 0.97 * task.validate()
