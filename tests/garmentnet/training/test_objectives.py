"""Losses against their definition."""

import copy
import dataclasses

import numpy as np
import torch

from garmentnet.configs.config import override
from garmentnet.paper.bones import remove_frame
from garmentnet.paper.high import HighFrequencyObjective
from garmentnet.paper.low import LowFrequencyObjective
from garmentnet.training.batches import batches, load_tracks
from garmentnet.training.losses import mesh_laplacian
from garmentnet.training.targets import LowTargets

_EXACT = ["low.dropout=0.0"]
_NAME = "base-train-0"


def _low(network, bones):
    targets = LowTargets(bones, network.features, [_NAME])
    return LowFrequencyObjective(network, targets, load_tracks(network, bones, [_NAME]), [])


def test_low_loss_against_vertices(toy_store, toy_bones, toy_network, monkeypatch):
    """The loss that never sees a vertex, and its gradient, against the paper's sum over them."""
    network = toy_network.networks[0]
    monkeypatch.setattr(network, "config", override(network.config, _EXACT))
    task = _low(network, toy_bones)
    batch = next(batches(task.tracks, 1, 20, None))
    monkeypatch.setattr("garmentnet.paper.low._EVERY", 1)
    loss, _ = task.loss(batch, None, np.random.default_rng(0))
    torch.autograd.backward(loss)
    got = [p.grad.clone() for p in network.low.parameters()]

    network.low.zero_grad()
    z, _ = network.low(batch.inputs())
    (track,) = task.tracks
    low = toy_bones.split(_NAME, slice(0, 20))[0]
    truth = torch.from_numpy(remove_frame(track.frame[:20], low)).float()
    joints = track.joints(slice(0, 20))
    gap = (network.mesh(z[batch.mask], joints) - truth)[:, network.free]
    # What the body carries is exact in the prediction, so its part of the Laplacian cancels.
    whole = torch.zeros_like(truth)
    whole[:, network.free] = gap
    laplacian = mesh_laplacian(toy_store.faces, toy_store.n_vertices)
    dense = torch.from_numpy(laplacian.toarray()).float()
    bent = (dense @ whole)[:, network.free]
    plain = sum(x.square().sum(-1).mean(-1).sqrt().mean() for x in (gap, bent))
    torch.autograd.backward(plain)
    # Targets are in half precision.
    assert abs((loss - plain).item()) < 1e-3 * plain.item()
    for a, p in zip(got, network.low.parameters(), strict=True):
        assert float((a - p.grad).norm()) < 1e-2 * float(p.grad.norm())
    network.low.zero_grad()


def test_a_window_of_one_frame(toy_bones, toy_network, monkeypatch):
    """The last window of a lane; the loss looks at every third frame, and at one at least."""
    network = toy_network.networks[0]
    monkeypatch.setattr(network, "config", override(network.config, _EXACT))
    task = _low(network, toy_bones)
    (track,) = task.tracks
    short = dataclasses.replace(
        track, inputs=track.inputs[:1], frame=track.frame[:1], extra=track.extra[:1]
    )
    batch = next(batches([short], 2, 20, None))
    for seed in range(4):
        assert float(task.loss(batch, None, np.random.default_rng(seed))[0].detach()) > 0


@torch.no_grad()
def test_the_high_module_is_judged_by_its_own_error(toy_store, toy_bones, toy_network):
    network = toy_network.networks[0]
    tracks = load_tracks(network, toy_bones, [_NAME])
    task = HighFrequencyObjective(network, tracks, tracks, start=True)
    before = task.validate()
    (track,) = tracks
    high, _ = network.high(
        network.high_inputs(track.inputs[None], task.tracks[0].extra[None]),
        network.mesh(task.tracks[0].extra[None], track.joints()[None]),
    )
    gap = (high[0] - track.detail())[:, network.free]
    assert abs(before - float(gap.square().sum(-1).mean().sqrt())) < 1e-6
    # Another low part does not change what is asked of the detail.
    code = network.low.code
    mean = code.mean.clone()
    code.mean += 0.01
    after = HighFrequencyObjective(network, tracks, tracks, start=True).validate()
    code.mean.copy_(mean)  # to the bit: other tests share the network
    assert abs(after - before) < 0.2 * before


@torch.no_grad()
def test_a_lane_that_is_finished_counts_for_nothing(toy_bones, toy_faithful):
    """Neither in the loss nor in the statistics of the batch normalisation."""
    network = copy.deepcopy(toy_faithful.networks[0])
    tracks = load_tracks(network, toy_bones, [_NAME])
    task, found = HighFrequencyObjective(network, tracks, [], start=True), []
    network.high.train()
    width = network.config.high.hidden
    for lanes in (1, 3):
        batch = next(batches(task.tracks, lanes, 20, None))
        loss, state = task.loss(batch, torch.ones(1, lanes, width), np.random.default_rng(0))
        found.append((loss, state[:, 0]))
    torch.testing.assert_close(found[0], found[1])
