import dataclasses
import warnings

import numpy as np
import pytest

from garmentnet.collision.body_tree import BodyTree
from garmentnet.data.parameters import SimulationParameters
from garmentnet.prediction.prediction import predict
from helpers import toy_store as toy
from ssdr.common.errors import InputError, SsdrWarning


def test_a_single_network(toy_network, joints, toy_store):
    p = predict(toy_network, joints, push_out=False)
    assert np.array_equal(p.cloth.vertices, toy_network.predict(joints))
    assert p.pushed is None
    assert np.abs(p.body.vertices - toy_store.clip("base-test-0").body(slice(0, 12))).max() < 1e-5
    assert np.array_equal(
        predict(toy_network, joints, toy.BASE, push_out=False).cloth.vertices, p.cloth.vertices
    )
    with pytest.raises(InputError, match="single network"):
        predict(toy_network, joints, SimulationParameters(bending=1.0))


def test_nan_poses(toy_network, joints):
    broken = joints.copy()
    broken[2] = np.nan
    with pytest.raises(InputError, match="frame 2"):
        predict(toy_network, broken)


def test_extrapolation_is_stated(pair, joints):
    with warnings.catch_warnings(action="error"):
        predict(pair, joints, SimulationParameters(bending=1.0))
    with pytest.warns(SsdrWarning, match=r"extrapolated: bending 3, trained from 0\.5 to 2$"):
        predict(pair, joints, SimulationParameters(bending=3.0))
    with pytest.raises(InputError, match="parameters"):
        predict(pair, joints)


def test_skinning_is_the_low_part(pair, joints):
    p = predict(pair, joints, SimulationParameters(bending=1.0), detail=False, push_out=False)
    assert np.abs(p.skinning.skin() - p.cloth.vertices).max() < 1e-5


def test_vertices_inside_the_body_are_pushed_out(toy_network, joints):

    # The same body, so wide that it reaches through the skirt.
    network = toy_network.networks[0]
    b = network.subject.body
    wide = dataclasses.replace(b, rest=b.rest * np.array([2.2, 1, 2.2], np.float32))
    before = network.subject
    network.subject = dataclasses.replace(before, body=wide)
    try:
        plain = predict(toy_network, joints, push_out=False)
        p = predict(toy_network, joints)
    finally:
        network.subject = before
    measure = BodyTree(wide)
    assert (measure.signed_distance(plain.cloth.vertices, joints) < -5e-4).mean() > 0.02
    # What the body carries stays where it is.
    outside = measure.signed_distance(p.cloth.vertices, joints) >= -5e-4
    assert outside[:, network.free].all()
    way = np.linalg.norm(p.cloth.vertices - plain.cloth.vertices, axis=2)
    assert p.pushed.moved > 0.02
    assert p.pushed.farthest == pytest.approx(float(way.max()), abs=1e-6)
    assert np.array_equal(p.skinning.transforms, plain.skinning.transforms)
