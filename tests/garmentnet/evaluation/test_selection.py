"""Groups of test clips, patterns of names, checkpoints that differ in seed."""

# ruff: noqa: E402
import dataclasses
import types

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from garmentnet.data.motion import CLASSES
from garmentnet.evaluation.selection import group_of, matching, seeds_of
from garmentnet.networks.checkpoint import Checkpoint
from ssdr.errors import InputError


def clip(motion, *, file="", label="walk"):
    classes = np.full(5, CLASSES.index(label))
    return types.SimpleNamespace(
        motion=motion, classes=classes, provenance={"motion": {"file": file}}
    )


def test_motions_are_grouped_by_name_or_source():
    assert group_of(clip("dance-22000")) == "dance"
    assert group_of(clip("small-2010")) == "small"
    assert group_of(clip("60_01_00")) == "60_01"  # by name alone
    assert group_of(clip("60_01_00", label="recorded")) == "recorded"
    assert group_of(clip("60_01_00", file="60_01.bvh")) == "recorded"
    assert group_of(clip("still")) == "still"


def test_groups_of_stores_that_say_less_of_the_motion(toy_store):
    assert group_of(toy_store.clip("base-test-0")) == "test"


def test_patterns_choose_clips():
    names = {"a": ["base-dance-1", "base-small-1", "base-small-2"], "b": ["set1-dance-1"]}
    assert matching(names, []) == names
    assert matching(names, ["base-small-*"]) == {"a": ["base-small-1", "base-small-2"], "b": []}
    assert matching(names, ["*-1"])["b"] == ["set1-dance-1"]
    with pytest.raises(InputError, match=r"clips: .*base-dance-1.*got 'base-big-\*'"):
        matching(names, ["base-small-*", "base-big-*"])


def test_checkpoints_that_differ_in_seed_alone_belong_together(toy_network):
    def seeded(seed, **train):
        (network,) = toy_network.networks
        other = types.SimpleNamespace(**vars(network))
        changed = dataclasses.replace(network.config.train, seed=seed, **train)
        other.config = dataclasses.replace(network.config, train=changed)
        other.normaliser = network.normaliser
        return Checkpoint((other,), toy_network.parameters, None)

    models = {"a": seeded(0), "b": seeded(1), "again": seeded(1), "long": seeded(2, epochs=99)}
    assert seeds_of(models) == [{0: "a", 1: "b"}]
    assert seeds_of({"a": models["a"], "long": models["long"]}) == []
    other = seeded(3)
    mean = np.array(other.networks[0].normaliser.mean) + 1
    other.networks[0].normaliser = dataclasses.replace(other.networks[0].normaliser, mean=mean)
    assert seeds_of({"a": models["a"], "other clips": other}) == []
