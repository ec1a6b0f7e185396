"""Stages of bones that hang on joints."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import trees
from helpers.measures import rmse_of, run_of
from ssdr.drivers.schedule import FIRST_MODEL
from ssdr.joints.stages import AddBones, AttachToJoints, RemoveBones
from ssdr.search.given import Given
from ssdr.search.run import Run
from ssdr.solver.trajectories import gather


@pytest.fixture(scope="module")
def made() -> trees.Skeleton:
    return trees.skeleton(6, 24, seed=3)


def _run(made: trees.Skeleton, bones: int, *stages: object, given: Given | None = None) -> Run:
    data = gather([ssdr.MeshSequence(made.frames)], bones=8)
    run = run_of(data, [*FIRST_MODEL, *stages], bones, 2, given=given)
    run.drive()
    return run


def _attached(run: Run, frames: np.ndarray, bones: int) -> ssdr.Skinning:
    """The present model in the world, whose joints do not come apart."""
    model = run.present
    assert model.n_bones == bones
    assert model.tree is not None
    assert model.tree.rigid
    rest, transforms = run.whole.to_world(model.rest, model.transforms)
    points, _ = run.whole.to_world(model.tree.points, model.transforms)
    parts = {"parents": model.tree.parents, "joint_positions": points}
    skinning = ssdr.Skinning(rest, model.indices, model.weights, transforms, **parts)
    assert skinning.joint_gaps().max() < 1e-9
    error = np.sqrt(model.weighted_error(run.whole) / frames.shape[0] / frames.shape[1])
    assert rmse_of(skinning, frames) == pytest.approx(run.whole.scale * error, rel=1e-6)
    return skinning


def test_bones_are_attached_and_removed_one_by_one(made: trees.Skeleton) -> None:
    run = _run(made, 8, AttachToJoints())
    _attached(run, made.frames, 8)
    run.bones = 5
    before = run.iteration
    for k, _ in enumerate(run.steps_of(RemoveBones())):
        _attached(run, made.frames, 7 - k)
    assert run.iteration == before + 18


@pytest.mark.parametrize("parents", [(-1, -1), (4, 2)])
def test_bones_are_added_as_leaves_below_those_that_were_named(
    made: trees.Skeleton, parents: tuple[int, ...]
) -> None:
    run = _run(made, 6, AttachToJoints(), given=Given(extra_parents=parents))
    before = _attached(run, made.frames, 6)
    value = run.value(run.present)
    run.bones = 8
    for _ in run.steps_of(AddBones()):
        pass
    grown = _attached(run, made.frames, 8)
    assert np.array_equal(grown.parents[:6], before.parents)
    named = [p for p in parents if p >= 0]
    assert not named or grown.parents[6:].tolist() == named
    assert run.value(run.present) <= value
