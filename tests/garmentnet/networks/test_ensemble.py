"""The kernel, and networks mixed by it."""

import copy
import dataclasses

import numpy as np
import pytest
import torch

from garmentnet.data.parameters import SimulationParameters
from garmentnet.networks.checkpoint import Checkpoint
from garmentnet.paper.ensemble import Kernel
from ssdr.common.errors import InputError

PIVOTS = (SimulationParameters(), SimulationParameters(bending=1.5))


def test_weights_are_convex_and_smooth():
    kernel = Kernel(2)
    pivots = np.array([[-1.0, 0], [0, 0.5], [1, 0]])
    sweep = np.stack([np.linspace(-1.5, 1.5, 61), np.zeros(61)], axis=1)
    w = np.stack([kernel.weights(pivots, t) for t in sweep])
    assert w.min() >= 0
    assert np.allclose(w.sum(axis=1), 1)
    assert np.abs(np.diff(w, axis=0)).max() < 0.1
    # The formula itself.
    g = kernel.g(torch.from_numpy(pivots)).detach().numpy()
    at = kernel.g(torch.from_numpy(sweep[7])).detach().numpy()
    psi = np.exp(-(np.linalg.norm(g - at, axis=1) ** 2))
    assert np.allclose(w[7], psi / psi.sum(), atol=1e-6)
    # At a pivot the slope is finite.
    x = torch.tensor(pivots[1], requires_grad=True)
    torch.autograd.backward(kernel(torch.from_numpy(pivots), x)[1])
    assert bool(torch.isfinite(x.grad).all())


def test_far_away_weights_do_not_underflow():
    kernel = Kernel(1)
    with torch.no_grad():
        kernel.g[2].weight.mul_(1e6)
    w = kernel.weights(np.array([[-1.0], [1.0]]), np.array([0.9]))
    assert np.allclose(w, [0, 1])


def test_mixed_bones_are_mixed_meshes(toy_network, toy_store):
    network = toy_network.networks[0]

    other = copy.deepcopy(network)
    with torch.no_grad():
        for p in other.low.parameters():
            p.add_(0.02 * torch.randn(p.shape, generator=torch.Generator().manual_seed(1)))
    ensemble = Checkpoint((network, other), PIVOTS, Kernel())
    theta = SimulationParameters(bending=0.8)
    joints = toy_store.clip("base-test-0").joints[:20]
    w = ensemble.weights(theta)
    mixed = sum(
        a * n.predict(joints, detail=False) for a, n in zip(w, ensemble.networks, strict=True)
    )
    assert np.abs(ensemble.predict(joints, theta, detail=False) - mixed).max() < 2e-6
    full = sum(a * n.predict(joints) for a, n in zip(w, ensemble.networks, strict=True))
    whole = ensemble.predict(joints, theta)
    assert np.abs(whole - full).max() < 2e-6
    state, steps = None, []
    for pose in joints:
        state, vertices = ensemble.step(state, pose, parameters=theta)
        steps.append(vertices)
    assert np.abs(np.stack(steps) - whole).max() < 3e-6


def test_pivots_must_share_their_bones(toy_network):

    network = toy_network.networks[0]
    other = copy.deepcopy(network)
    g = network.subject.garment
    moved = dataclasses.replace(g, rest=g.rest + np.float32(0.1))
    other.subject = dataclasses.replace(network.subject, garment=moved)
    with pytest.raises(InputError, match="rest pose"):
        Checkpoint((network, other), PIVOTS, Kernel())
