"""Steps of bones that hang on joints."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import trees
from helpers.measures import descent_of, rmse_of
from ssdr.search.descent import Descent
from ssdr.search.problem import Initial
from ssdr.search.starts import first_model
from ssdr.search.trees.tree_steps import add_bones, attach, remove_bones
from ssdr.solver.trajectories import gather


@pytest.fixture(scope="module")
def made() -> trees.Skeleton:
    return trees.skeleton(6, 24, seed=3)


def _attach_first(d: Descent) -> None:
    first_model(d)
    attach(d)


def _descent(made: trees.Skeleton, bones: int, initial: Initial | None = None) -> Descent:
    data = gather([ssdr.MeshSequence(made.frames)], bones=8)
    d = descent_of(data, bones, 2, initial=initial)
    d.follow(_attach_first)
    return d


def _attached(d: Descent, frames: np.ndarray, bones: int) -> ssdr.Skinning:
    """The present model in the world, whose joints do not come apart."""
    model = d.model
    assert model.n_bones == bones
    assert model.tree is not None
    assert model.tree.rigid
    rest, transforms = d.data.alignment.to_world(model.rest, model.transforms)
    points, _ = d.data.alignment.to_world(model.tree.points, model.transforms)
    parts = {"parents": model.tree.parents, "joint_positions": points}
    skinning = ssdr.Skinning(rest, model.indices, model.weights, transforms, **parts)
    assert skinning.joint_gaps().max() < 1e-9
    error = np.sqrt(model.weighted_error(d.data) / frames.shape[0] / frames.shape[1])
    assert rmse_of(skinning, frames) == pytest.approx(d.data.alignment.scale * error, rel=1e-6)
    return skinning


def test_bones_are_attached_and_removed_one_by_one(made: trees.Skeleton) -> None:
    d = _descent(made, 8)
    _attached(d, made.frames, 8)
    d.bones = 5
    before = d.work.iteration
    left = [7, 6, 5]

    def after_step(_: str) -> None:
        _attached(d, made.frames, left.pop(0))

    d.follow(remove_bones, after_step)
    assert not left
    assert d.work.iteration == before + 18


@pytest.mark.parametrize("parents", [(-1, -1), (4, 2)])
def test_bones_are_added_as_leaves_below_those_that_were_named(
    made: trees.Skeleton, parents: tuple[int, ...]
) -> None:
    d = _descent(made, 6, Initial(extra_parents=parents))
    before = _attached(d, made.frames, 6)
    value = d.value(d.model)
    d.bones = 8
    d.follow(add_bones)
    grown = _attached(d, made.frames, 8)
    assert np.array_equal(grown.parents[:6], before.parents)
    named = [p for p in parents if p >= 0]
    assert not named or grown.parents[6:].tolist() == named
    assert d.value(d.model) <= value
