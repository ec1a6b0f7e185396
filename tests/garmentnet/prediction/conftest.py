"""A pair of pivots and a motion, for all tests of predictions."""

import copy

import pytest


@pytest.fixture(scope="module")
def pair(toy_network):
    import torch

    from garmentnet.data.parameters import SimulationParameters
    from garmentnet.networks.checkpoint import Checkpoint
    from garmentnet.paper.ensemble import Kernel
    from helpers import toy_store as toy

    network = toy_network.networks[0]
    other = copy.deepcopy(network)
    with torch.no_grad():
        other.low.out.bias.add_(0.2)
    stiff = SimulationParameters(bending=2.0)
    return Checkpoint((network, other), (toy.BASE, stiff), Kernel())


@pytest.fixture(scope="module")
def joints(toy_store):
    return toy_store.clip("base-test-0").joints[:12]
