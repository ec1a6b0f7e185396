"""A method with its vertices moved out of the body."""

# ruff: noqa: E402

import numpy as np
import pytest

pytest.importorskip("torch")

from garmentnet.collision.push_out import PushOut
from garmentnet.evaluation.pushed import pushed_method
from garmentnet.evaluation.scores import Answer, evaluate, network_method


def test_nothing_is_left_inside(toy_store, toy_bones):
    """A cloth that is drawn toward the body's axis enters it, and comes out again."""

    def narrow(clip):
        fitted = toy_bones.clip(clip.name)
        low = fitted.read("low")
        axis = low.mean(axis=1, keepdims=True) * [1, 0, 1] + low * [0, 1, 0]
        return Answer(np.float32(0.2 * low + 0.8 * axis), fitted.read("high"))

    clip = toy_store.clip("base-test-0")
    before, after = narrow(clip), pushed_method(narrow, toy_store)(clip)
    assert np.array_equal(after.low, before.low)
    push = PushOut(toy_store.body, toy_store.faces, n_vertices=toy_store.n_vertices)
    free = ~toy_store.pinned
    depths = [-push.signed_distance(a.low + a.high, clip.joints)[:, free] for a in (before, after)]
    assert (depths[0] > 5e-4).mean() > 0.05
    assert (depths[1] > 5e-4).mean() < 0.1 * (depths[0] > 5e-4).mean()
    gap = np.abs(after.high - before.high).max(axis=2)
    assert gap[:, toy_store.pinned].max(initial=0) == 0


def test_beside_the_network(toy_store, toy_bones, toy_network):
    method = network_method(toy_network)
    methods = {"plain": method, "pushed": pushed_method(method, toy_store)}
    plain, pushed = evaluate(toy_bones, methods, ["base-test-0"])
    assert pushed.inside <= plain.inside
    assert abs(pushed.overall.rmse - plain.overall.rmse) < 0.2 * plain.overall.rmse
