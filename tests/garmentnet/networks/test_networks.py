# ruff: noqa: E402
import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import toy_store as toy
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from garmentnet.networks.high_frequency import EdgeConv, HighFrequency, neighbour_table
from garmentnet.networks.low_frequency import BoneCode
from ssdr.errors import InputError


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


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([1.0, 0.02]))
def test_edge_conv_against_a_loop(seed, scale):
    torch.manual_seed(seed)
    _, faces, _ = toy.skirt(columns=8, rings=3)
    n, frames = 24, 2
    layer = EdgeConv(3, 5, scale).double()
    x = torch.randn(n, frames, 3, dtype=torch.float64)
    got = layer(x, neighbour_table(faces, n))
    for i, near in enumerate(neighbours_of(faces, n)):
        for f in range(frames):
            edges = [
                torch.relu(layer.linear(torch.cat([x[i, f], (x[j, f] - x[i, f]) / scale])))
                for j in near
            ]
            assert torch.allclose(got[i, f], torch.stack(edges).amax(0), atol=1e-12)


def test_edge_conv_gradient():
    torch.manual_seed(0)
    _, faces, _ = toy.skirt(columns=6, rings=2)
    layer = EdgeConv(2, 3).double()
    x = torch.randn(12, 1, 2, dtype=torch.float64, requires_grad=True)
    table = neighbour_table(faces, 12)
    assert torch.autograd.gradcheck(lambda v: layer(v, table), (x,))


@pytest.mark.parametrize("rotation", ["euler", "vector", "sixd"])
def test_bone_code_round_trip(rotation):
    rng = np.random.default_rng(0)
    m = np.concatenate(
        [
            Rotation.random(60, rng=rng).as_matrix().reshape(12, 5, 3, 3),
            rng.normal(size=(12, 5, 3, 1)),
        ],
        axis=-1,
    )
    code = BoneCode(rng.normal(size=(5, 3)), rotation)
    code.fit(m)
    numbers = torch.from_numpy(code.numbers(m)).float()
    z = (numbers - code.mean) / code.deviation
    assert np.abs(code(z).numpy() - m).max() < 2e-5
    # Zero is the mean motion, and the translation is that of the bone's centre.
    assert np.allclose(
        code.numbers(code(0 * z).double().numpy())[0][:, -3:], code.mean[:, -3:], atol=1e-5
    )


def test_high_frequency_of_chosen_frames():
    torch.manual_seed(0)
    rest, faces, _ = toy.skirt(columns=8, rings=3)
    module = HighFrequency(
        6, faces, 24, hidden=16, global_features=4, edge_features=(8, 8), mlp=(8,), edge_length=0.1
    )
    x = torch.randn(2, 9, 6)
    low = torch.from_numpy(rest) + 0.01 * torch.randn(2, 9, 24, 3)
    whole, state = module(x, low)
    pick = torch.tensor([[0, 3, 8], [2, 2, 5]])
    index = pick[:, :, None, None].expand(-1, -1, 24, 3)
    some, same = module(x, low.gather(1, index), None, pick)
    assert torch.allclose(some, whole.gather(1, index), atol=1e-6)
    assert torch.equal(state, same)


@pytest.mark.parametrize("kind", ["toy_network", "toy_faithful"])
def test_streaming_is_batch(kind, request, toy_store):
    network = request.getfixturevalue(kind).networks[0]
    assert network.high is not None
    joints = toy_store.clip("base-test-0").joints[:40]
    whole = network.predict(joints)
    state, frames = None, []
    for pose in joints:
        state, vertices = network.step(state, pose)
        frames.append(vertices)
    assert np.abs(np.stack(frames) - whole).max() < 2e-6
    first, state = network.run(joints[:17])
    second, _ = network.run(joints[17:], state)
    pieces = np.concatenate([first.vertices(), second.vertices()])
    assert np.abs(pieces - whole).max() < 2e-6
    # Single frames of it; with long motions some of the pieces hold none of them.
    long = np.concatenate([joints] * 7)
    some = np.array([3, 139, 278])
    assert np.abs(network.predict(long, frames=some) - network.predict(long)[some]).max() < 2e-6


def test_rooted_prediction_moves_with_the_body(toy_network, toy_store):
    network, joints = toy_network.networks[0], toy_store.clip("base-test-0").joints[:30]
    turn = Rotation.from_euler("y", 2.2).as_matrix()
    there = turn @ joints.astype(np.float64)
    there[..., 3] += [5.0, 0.0, 1.0]
    expected = network.predict(joints) @ turn.T + [5.0, 0.0, 1.0]
    # float32 joints are rotations to 1e-7; accelerations multiply that by 900.
    assert np.abs(network.predict(there) - expected).max() < 1e-3


def test_world_transforms_skin_to_the_low_part(toy_network, toy_store):
    import ssdr

    network, joints = toy_network.networks[0], toy_store.clip("base-test-1").joints[:12]
    motion, _ = network.run(joints, detail=False)
    g = network.subject.garment
    posed = ssdr.skin(g.rest, g.joints, g.weights, motion.world_transforms())
    assert np.abs(posed - motion.vertices()).max() < 1e-5


def test_a_network_that_reads_parameters(toy_config, toy_store, toy_bones):
    from garmentnet.training.run import build_network, choose_clips

    config = toy_config()
    config = dataclasses.replace(config, data=dataclasses.replace(config.data, condition=True))
    names, chosen = choose_clips(toy_store, config)
    assert chosen is None
    assert len({toy_store.clip(n).parameters for n in names}) == 5  # training sets alone
    network = build_network(config, toy_bones, names[:2])
    joints = toy_store.clip(names[0]).joints[:5]
    with pytest.raises(InputError, match="parameters"):
        network.predict(joints)
    a = network.predict(joints, parameters=[0.0, 0.0, 0.0])
    b = network.predict(joints, parameters=[1.0, 0.0, 0.0])
    assert np.abs(a - b).max() > 1e-6
    high = network.add_high()
    assert high.gru.input_size == 10 * 9 + 3


def test_ablations_are_other_networks(toy_config, toy_store, toy_bones):
    from garmentnet.training.run import build_network

    config = toy_config()
    for change in ({"source": "body"}, {"local": False}):
        own = dataclasses.replace(config, high=dataclasses.replace(config.high, **change))
        network = build_network(own, toy_bones, ["base-train-0"])
        high = network.add_high()
        assert (len(high.edges) == 0) == (change.get("local") is False)
        expected = network.features.size if "source" in change else 90
        assert high.gru.input_size == expected
        joints = toy_store.clip("base-test-0").joints[:4]
        assert np.isfinite(network.predict(joints)).all()
