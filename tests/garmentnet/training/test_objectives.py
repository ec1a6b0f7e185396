"""Losses against their definition."""

# ruff: noqa: E402

import numpy as np
import pytest

torch = pytest.importorskip("torch")


from garmentnet.configs import override
from garmentnet.training.batches import batches, load_tracks
from garmentnet.training.objectives import LowFrequencyObjective


def test_low_loss_against_vertices(toy_store, toy_bones, toy_network, monkeypatch):
    """The loss that never sees a vertex, and its gradient, against the paper's sum over them."""
    network = toy_network.networks[0]
    monkeypatch.setattr(network, "config", override(network.config, ["low.dropout=0.0"]))
    task = LowFrequencyObjective(network, load_tracks(network, toy_bones, ["base-train-0"]), [])
    batch = next(batches(task.tracks, 1, 20, None))
    loss, _ = task.loss(batch, None, np.random.default_rng(0))
    torch.autograd.backward(loss)
    got = [p.grad.clone() for p in network.low.parameters()]

    network.low.zero_grad()
    z, _ = network.low(batch.inputs())
    gap = network.mesh(z[batch.mask]) - task.tracks[0].target("low", slice(0, 20))
    bent = torch.stack([torch.from_numpy(task._laplacian.toarray()).float() @ g for g in gap])
    plain = sum(x.square().sum(-1).mean(-1).sqrt().mean() for x in (gap, bent))
    torch.autograd.backward(plain)
    assert abs((loss - plain).item()) < 1e-5 * plain.item()
    for a, p in zip(got, network.low.parameters(), strict=True):
        assert float((a - p.grad).norm()) < 1e-3 * float(p.grad.norm())
    network.low.zero_grad()
