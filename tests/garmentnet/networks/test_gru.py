"""The GRU's backward pass against torch's own."""

# ruff: noqa: E402

import pytest

torch = pytest.importorskip("torch")

from garmentnet.networks.gru import GRU


def _slopes(module, x, state, weight):
    x = x.clone().requires_grad_()
    state = None if state is None else state.clone().requires_grad_()
    out, last = module(x, state)
    ((out * weight).sum() + last.square().sum()).backward()
    leaves = [x, *([state] if state is not None else []), *module.parameters()]
    found = [p.grad.clone() for p in leaves]
    module.zero_grad()
    return [out.detach(), last.detach(), *found]


@pytest.mark.parametrize("begun", [False, True])
def test_same_as_torch(begun):
    torch.manual_seed(0)
    own, theirs = GRU(5, 7), torch.nn.GRU(5, 7, batch_first=True)
    theirs.load_state_dict(own.state_dict())
    own, theirs = own.double(), theirs.double()
    x, weight = torch.randn(3, 11, 5).double(), torch.randn(3, 11, 7).double()
    state = torch.randn(1, 3, 7).double() if begun else None
    for a, b in zip(_slopes(own, x, state, weight), _slopes(theirs, x, state, weight), strict=True):
        assert torch.allclose(a, b, rtol=1e-10, atol=1e-12)
    with torch.no_grad():
        assert torch.equal(own(x, state)[0], theirs(x, state)[0])
