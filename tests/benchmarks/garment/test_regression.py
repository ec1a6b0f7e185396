"""The baselines that regress offsets or positions."""

import numpy as np
import pytest
import torch

import ssdr
from benchmarks.garment.regression import FrameMLP, Unposed, WindowMLP
from garmentnet.evaluation.baselines import body_skinning

NAME = "base-train-0"


@pytest.mark.parametrize("part", ["whole", "low"])
def test_unposed_offsets_are_skinned(toy_bones, toy_store, part):
    space, s = Unposed(toy_bones), body_skinning(toy_store)
    rng = np.random.default_rng(0)
    offsets = (0.05 * rng.normal(size=(4, s.n_vertices, 3))).astype(np.float32)
    joints = toy_store.clip(NAME).joints[20:24]
    got = space.add(offsets, joints, part)
    for t in range(4):
        expected = ssdr.skin(s.rest + offsets[t], s.indices, s.weights, joints[t])
        assert np.abs(got[t] - expected).max() < 1e-5
    assert np.abs(space.remove(got, joints, part) - offsets).max() < 1e-3


def test_unposed_detail_is_turned(toy_bones, toy_store):
    space = Unposed(toy_bones)
    rng = np.random.default_rng(0)
    detail = (0.01 * rng.normal(size=(3, toy_store.n_vertices, 3))).astype(np.float32)
    joints = toy_store.clip(NAME).joints[20:23]
    moved = np.array(joints)
    moved[..., 3] += 7.0  # where the body stands plays no part
    got = space.remove(detail, moved, "high")
    assert np.abs(space.remove(detail, joints, "high") - got).max() < 1e-7
    assert np.abs(space.add(got, joints, "high") - detail).max() < 2e-4


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
