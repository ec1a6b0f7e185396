"""EdgeConv against loops, and the high-frequency module."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from garmentnet.configs.config import HighOptions
from garmentnet.networks.gru import dropout_mask
from garmentnet.paper.high import EdgeConv, HighFrequency, neighbour_table
from helpers import toy_store as toy

PLAIN = {"batch_norm": False}


def neighbours_of(faces, n):
    found = [set() for _ in range(n)]
    for a, b, c in faces:
        for p, q in ((a, b), (b, c), (c, a)):
            found[p].add(int(q))
            found[q].add(int(p))
    return found


def test_neighbour_table():
    _, faces, _ = toy.skirt()
    expected = neighbours_of(faces, 113)  # one vertex is of no triangle
    table = neighbour_table(faces, 113).numpy()
    for i in range(113):
        assert set(table[i]) == (expected[i] or {i})


def by_loop(layer, x, near, act, scale=1.0):
    """Largest features of a vertex' edges, an edge after the other; 0 where it has none."""
    out = torch.zeros(*x.shape[:2], layer.linear.out_features, dtype=x.dtype)
    for i, f in np.ndindex(*x.shape[:2]):
        edges = [
            act(layer.linear(torch.cat([x[i, f], (x[j, f] - x[i, f]) / scale]))) for j in near[i]
        ]
        if edges:
            out[i, f] = torch.stack(edges).amax(0)
    return out


@settings(max_examples=15)
@given(st.integers(0, 10**6), st.sampled_from([1.0, 0.02]))
def test_edge_conv_against_a_loop(seed, scale):
    torch.manual_seed(seed)
    _, faces, _ = toy.skirt(columns=8, rings=3)
    layer = EdgeConv(3, 5, scale).double()
    x = torch.randn(24, 2, 3, dtype=torch.float64)
    got = layer(x, neighbour_table(faces, 24))
    assert torch.allclose(
        got, by_loop(layer, x, neighbours_of(faces, 24), layer.act, scale), atol=1e-12
    )


def test_edge_conv_gradient():
    torch.manual_seed(0)
    _, faces, _ = toy.skirt(columns=6, rings=2)
    layer = EdgeConv(2, 3).double()
    x = torch.randn(12, 1, 2, dtype=torch.float64, requires_grad=True)
    table = neighbour_table(faces, 12)
    assert torch.autograd.gradcheck(lambda v: layer(v, table), (x,))


def test_high_frequency_of_chosen_frames():
    torch.manual_seed(0)
    rest, faces, _ = toy.skirt(columns=8, rings=3)
    small = HighOptions(**PLAIN, hidden=16, global_features=4, edge_features=(8, 8))
    module = HighFrequency(6, faces, 24, small, edge_length=0.1)
    x = torch.randn(2, 9, 6)
    low = torch.from_numpy(rest) + 0.01 * torch.randn(2, 9, 24, 3)
    whole, state = module(x, low)
    pick = torch.tensor([[0, 3, 8], [2, 2, 5]])
    index = pick[:, :, None, None].expand(-1, -1, 24, 3)
    some, same = module(x, low.gather(1, index), None, pick)
    assert torch.allclose(some, whole.gather(1, index), atol=1e-6)
    assert torch.equal(state, same)


def test_edge_conv_without_some_edges():
    torch.manual_seed(0)
    _, faces, _ = toy.skirt(columns=8, rings=3)
    layer = EdgeConv(3, 5).double()
    x = torch.randn(24, 2, 3, dtype=torch.float64)
    small = HighOptions(**PLAIN, hidden=4, global_features=2, edge_features=(5,))
    module = HighFrequency(2, faces, 24, small, edge_length=1.0)
    dropped = module.draw_edges(np.random.default_rng(3), 0.7)[0]
    table = module.neighbours
    stays = {
        (i, int(j)) for i in range(24) for j, d in zip(table[i], dropped[i], strict=True) if not d
    }
    assert all((j, i) in stays for i, j in stays)  # in both directions
    got = layer(x, table, dropped)
    near = [[j for j in of if (i, j) in stays] for i, of in enumerate(neighbours_of(faces, 24))]
    assert torch.allclose(got, by_loop(layer, x, near, layer.act), atol=1e-12)
    assert 0 < sum(not of for of in near) < 24
    torch.autograd.backward(got.sum())
    assert all(bool(torch.isfinite(p.grad).all()) for p in layer.parameters())


def test_dropped_shares():
    _, faces, _ = toy.skirt()
    small = HighOptions(**PLAIN, hidden=50, global_features=2, edge_features=(4, 4))
    module = HighFrequency(2, faces, 112, small, edge_length=1.0)
    rng = np.random.default_rng(0)
    first, second = module.draw_edges(rng, 0.8)
    assert not torch.equal(first, second)
    many = [torch.stack(module.draw_edges(rng, 0.8)).double().mean() for _ in range(20)]
    assert abs(float(torch.stack(many).mean()) - 0.8) < 0.02
    cpu = torch.device("cpu")
    mask, again = (dropout_mask(np.random.default_rng(0), (8, 4, 50), 0.5, cpu) for _ in range(2))
    assert set(mask.unique().tolist()) == {0.0, 2.0}
    assert abs(float(mask.mean()) - 1) < 0.1
    assert torch.equal(again, mask)


@torch.no_grad()
def test_detail_of_some_vertices():
    torch.manual_seed(0)
    rest, faces, _ = toy.skirt(columns=8, rings=3)
    chosen = np.array([1, 5, 9, 23])
    small = HighOptions(hidden=16, global_features=4, edge_features=(8,))
    module = HighFrequency(6, faces, 24, small, edge_length=0.1, vertices=chosen)
    module.mean.fill_(0.5)
    out, _ = module.eval()(torch.randn(2, 3, 6), torch.from_numpy(rest).expand(2, 3, 24, 3))
    others = np.setdiff1d(np.arange(24), chosen)
    assert float(out[:, :, others].abs().max()) == 0
    assert float(out[:, :, chosen].abs().min()) > 0
    assert module.spread.weight.shape == (16, 16)


def test_a_short_training_ends_with_statistics_of_its_last_batches():
    torch.manual_seed(0)
    rest, faces, _ = toy.skirt(columns=6, rings=2)
    net = HighFrequency(4, faces, len(rest), HighOptions(hidden=8), edge_length=0.1).train()
    for k in range(60):
        x, low = torch.randn(8, 6, 4), torch.zeros(8, 6, len(rest), 3)
        net(x, low)
        if k == 30:  # what it has learned changes the features
            torch.nn.init.normal_(net.spread.weight, std=3.0)
    seen = []
    net.norm.register_forward_hook(lambda _, __, out: seen.append(out))
    net.eval()(x, low)
    assert 0.9 < float(seen[0].detach().std()) < 1.1
