import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ssdr
from garmentnet.networks.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from garmentnet.paper.train import build_network, choose_clips
from ssdr.common.errors import InputError


@pytest.mark.parametrize("kind", ["toy_network", "toy_faithful", "toy_basis"])
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


def test_rooted_prediction_moves_with_the_body(toy_network, toy_store):
    network, joints = toy_network.networks[0], toy_store.clip("base-test-0").joints[:30]
    turn = Rotation.from_euler("y", 2.2).as_matrix()
    there = turn @ joints.astype(np.float64)
    there[..., 3] += [5.0, 0.0, 1.0]
    expected = network.predict(joints) @ turn.T + [5.0, 0.0, 1.0]
    # float32 joints are rotations to 1e-7; accelerations multiply that by 900.
    assert np.abs(network.predict(there) - expected).max() < 1e-3


def test_world_transforms_skin_to_the_low_part(toy_network, toy_store):

    network, joints = toy_network.networks[0], toy_store.clip("base-test-1").joints[:12]
    motion, _ = network.run(joints, detail=False)
    g = network.subject.garment
    posed = ssdr.skin(g.rest, g.indices, g.weights, motion.world_transforms())
    # The body carries the others.
    assert len(network.free) < g.n_vertices
    assert np.abs(posed - motion.vertices())[:, network.free].max() < 1e-5


def test_a_network_that_reads_parameters(toy_config, toy_store, toy_bones):

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


def test_what_the_body_carries_is_exact(toy_network, toy_store):
    network, clip = toy_network.networks[0], toy_store.clip("base-test-1")
    bound = network.subject.bound
    truth = clip.sequence.frames(slice(None))
    gap = np.abs(network.predict(clip.joints) - truth)
    assert gap[:, bound.index].max() < 1e-5
    assert gap[:, network.free].max() > 1e-3
    # Frame by frame too, and without the detail its smooth shape.
    _, one = network.step(None, clip.joints[0])
    assert np.abs(one - truth[0])[bound.index].max() < 1e-5
    smooth = network.predict(clip.joints, detail=False)

    skinned = ssdr.skin(bound.smooth, bound.indices, bound.weights, clip.joints.astype(float))
    assert np.abs(smooth[:, bound.index] - skinned).max() < 1e-5


def test_networks_without_carried_vertices_predict_all(toy_network, toy_store, tmp_path):
    network = toy_network.networks[0]
    subject = dataclasses.replace(network.subject, bound=None)
    plain = type(network)(network.config, subject, network.normaliser).eval()
    plain.low.load_state_dict(network.low.state_dict())
    joints = toy_store.clip("base-test-1").joints[:5]
    a, b = plain.predict(joints), network.predict(joints, detail=False)
    assert len(plain.free) == toy_store.n_vertices
    assert np.abs(a - b)[:, network.free].max() < 1e-6
    one = Checkpoint((plain,), toy_network.parameters, None)
    again = load_checkpoint(save_checkpoint(one, tmp_path / "a.safetensors"))
    assert np.array_equal(again.predict(joints), a)
