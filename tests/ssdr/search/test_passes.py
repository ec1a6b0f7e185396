"""Passes over all frames."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions, terms
from ssdr.problem import scan
from ssdr.problem.problem import Initial
from ssdr.search.passes import AllFrames, carried
from ssdr.solver.alternation import bone_step, vertex_step
from ssdr.solver.initialization import start_model
from ssdr.solver.model import Constraints, Model
from ssdr.solver.rest_normals import with_rest_normals
from ssdr.solver.rest_surface import RestSurface
from ssdr.solver.trajectories import gather


def of_free_model(*args: Any, importance: np.ndarray | None) -> AllFrames:
    """Passes from a model in which nothing is locked or given."""
    return AllFrames(*args, constraints=Constraints(), initial=Initial(), importance=importance)


@pytest.mark.usefixtures("tiny_memory")
def test_a_pass_is_one_exact_alternation() -> None:
    """The sums that a pass gathers give the error that skinning the model shows."""
    frames = motions.rippled(90)
    sequences = [ssdr.MeshSequence(frames[:50]), ssdr.MeshSequence(frames[50:])]
    found = scan.scan(sequences, None, keep=[7])
    assert {0, 7} <= set(found.chosen.tolist())
    assert found.importance(None).sum() == pytest.approx(90)
    few = scan.subset(sequences, found.chosen)
    np.testing.assert_array_equal(few.vertices, frames[found.chosen])
    data = gather([few], bones=4)
    model = start_model(data, data.frame(0), 4, 4, np.random.default_rng(0))
    vertex_step(data, model)
    passes = AllFrames(
        sequences, found, data, model, constraints=Constraints(), initial=Initial(), importance=None
    )
    values = [passes.pass_over(entering=3) for _ in range(3)]
    assert values == sorted(values, reverse=True)
    rest, transforms = found.alignment.to_world(passes.model.rest, passes.model.transforms)
    shown = motions.blend(rest, passes.model.indices, passes.model.weights, transforms)
    squared = ((shown - frames) ** 2).sum()
    assert values[-1] * found.alignment.scale**2 == pytest.approx(squared, rel=1e-8)


@pytest.mark.usefixtures("tiny_memory")
def test_a_pass_knows_the_strain_of_the_rest_pose_and_the_error_of_normals() -> None:
    frames, faces = motions.rippled(90), motions.chain(3, bones=4, frames=2).faces
    sequences = [ssdr.MeshSequence(frames, faces)]
    counts = 0.5 + np.random.default_rng(1).random(90)
    found = scan.scan(sequences, None, keep=[0])
    few = scan.subset(sequences, found.chosen)
    data = gather([few], bones=4, compress=False)
    surface = RestSurface.build(data, data.frame(3))
    data = dataclasses.replace(data, surface=surface).with_normals()
    model = start_model(data, data.frame(3), 4, 4, np.random.default_rng(0))
    vertex_step(data, model)
    model = with_rest_normals(data, model)
    passes = of_free_model(sequences, found, data, model, importance=counts)
    values = [passes.pass_over(entering=3) for _ in range(4)]
    assert values[1:] == sorted(values[1:], reverse=True)
    space = passes.space
    inner = found.alignment.inward(frames, 0, space.frame_scale)
    every = dataclasses.replace(space, z=inner.reshape(len(inner), -1))
    want = terms.value(every, passes.model, space.surface.pose)
    assert values[-1] == pytest.approx(want, rel=1e-7)
    assert want > 1.1 * passes.model.weighted_error(space)


@pytest.mark.usefixtures("tiny_memory")
def test_passes_end_when_one_gains_little_and_one_that_raises_the_objective_is_taken_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frames = motions.rippled(60)
    sequences = [ssdr.MeshSequence(frames)]
    found = scan.scan(sequences, None)
    data = gather([scan.subset(sequences, found.chosen)], bones=4)
    model = start_model(data, data.frame(0), 4, 4, np.random.default_rng(0))
    values: list[float] = []

    def pass_over(self: AllFrames, **_: object) -> float:
        self.model.rest[:] = self.passes = self.passes + 1
        return values[self.passes - 1]

    monkeypatch.setattr(AllFrames, "pass_over", pass_over)
    for values, kept in (
        ([9.0, 8.0, 8.5, 1.0], 2),
        ([9.0, 8.0, 8.0, 1.0], 2),
        ([9.0, 8.999, 1.0, 1.0], 2),
        ([9.0, 8.0, 7.0, 6.0], 4),
    ):
        passes = of_free_model(sequences, found, data, model, importance=None)
        assert list(passes.improve(4, entering=3)) == values[:kept]
        assert (passes.model.rest == kept).all()


def test_the_bones_of_a_model_to_start_from_are_given_again() -> None:
    data = gather([ssdr.MeshSequence(motions.rippled(12))], bones=4)
    model = start_model(data, data.frame(0), 4, 2, np.random.default_rng(0))
    own = np.random.default_rng(1).standard_normal((20, 4, 3, 4))
    nearest = np.arange(20) % 12
    moved = carried(model, nearest, 0.5, Initial(transforms=own, is_model=True))
    np.testing.assert_array_equal(moved.rest, 0.5 * model.rest)
    np.testing.assert_array_equal(moved.transforms, own)
    moved = carried(model, nearest, 0.5, Initial())
    np.testing.assert_array_equal(moved.transforms / [1, 1, 1, 0.5], model.transforms[nearest])


def test_rotations_leap_to_where_they_belong() -> None:
    """Far from the start, sweeps reach more with leaps between them than without."""
    rig = motions.chain(3, bones=4, frames=60)
    data = gather([ssdr.MeshSequence(rig.frames)], bones=4, compress=False)
    rest, exact = data.alignment.from_world(rig.rest, rig.transforms)
    assert exact is not None
    errors = []
    for leaps, sweeps in ((0, 6), (0, 12), (2, 6)):
        start = np.repeat(exact[:1], 60, axis=0)
        model = Model.start(start, rest, rig.indices[:, 0], rig.indices.shape[1])
        model.indices[:], model.weights[:] = rig.indices, rig.weights
        bone_step(data, model, sweeps=sweeps, constraints=Constraints(), leaps=leaps)
        r = model.transforms[..., :3]
        np.testing.assert_allclose(np.linalg.det(r), 1.0, atol=1e-9)
        np.testing.assert_allclose(
            r @ np.swapaxes(r, -1, -2), np.eye(3)[None, None] + 0 * r, atol=1e-9
        )
        shown = motions.blend(rest, model.indices, model.weights, model.transforms)
        errors.append(
            float(((shown - data.z.reshape(len(rest), 60, 3).transpose(1, 0, 2)) ** 2).sum())
        )
    assert errors[2] < errors[1] < errors[0]
