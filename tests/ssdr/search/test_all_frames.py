"""The walk that fits a model of chosen frames to all frames."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions, terms
from ssdr.search import scan
from ssdr.search.all_frames import fit_all_frames
from ssdr.search.check_problem import check_problem
from ssdr.search.problem import Problem
from ssdr.solver.alternation import bone_step, vertex_step
from ssdr.solver.initialization import start_model, with_rest_normals
from ssdr.solver.model import Constraints, Model
from ssdr.solver.objective import Objective
from ssdr.solver.rest_surface import RestSurface
from ssdr.solver.trajectories import gather


def problem_of(frames: Any, faces: Any = None, **options: Any) -> Problem:
    call = {"bones": 4, "influences": 4, "effort": "fast", "rng": 0} | options
    return check_problem(frames, faces, **call)


@pytest.mark.usefixtures("tiny_memory")
def test_a_walk_is_one_exact_alternation() -> None:
    """The sums that a walk gathers give the error that skinning the model shows."""
    frames = motions.rippled(90)
    sequences = [ssdr.MeshSequence(frames[:50]), ssdr.MeshSequence(frames[50:])]
    found = scan.scan(sequences, None, 7, spread=False)
    assert {0, 7} <= set(found.chosen.tolist())
    few = scan.subset(sequences, found.chosen)
    np.testing.assert_array_equal(few.vertices, frames[found.chosen])
    data = gather([few], bones=4)
    model = start_model(data, data.frame(0), 4, 4, np.random.default_rng(0))
    vertex_step(data, model)
    shares: list[float] = []
    alignment, moved = fit_all_frames(
        problem_of(sequences), found, data, model, report=shares.append
    )
    assert shares == sorted(shares)
    assert shares[-1] == 1

    def squared(model: Model, moves: np.ndarray) -> float:
        rest, transforms = alignment.to_world(model.rest, moves)
        shown = motions.blend(rest, model.indices, model.weights, transforms)
        return float(((shown - frames) ** 2).sum())

    after = squared(moved, moved.transforms)
    assert moved.error.sum() * alignment.scale**2 == pytest.approx(after, rel=1e-8)
    assert after < 0.9 * squared(model, model.transforms[found.nearest])


@pytest.mark.usefixtures("tiny_memory")
def test_a_walk_knows_the_strain_of_the_rest_pose_and_the_error_of_normals() -> None:
    frames, faces = motions.rippled(90), motions.chain(3, bones=4, frames=2).faces
    sequences = [ssdr.MeshSequence(frames, faces)]
    counts = 0.5 + np.random.default_rng(1).random(90)
    found = scan.scan(sequences, None, 0, spread=False)
    data = gather([scan.subset(sequences, found.chosen)], bones=4, compress=False)
    surface = RestSurface.build(data.faces, data.frame(3))
    data = dataclasses.replace(data, surface=surface).with_normals()
    model = start_model(data, data.frame(3), 4, 4, np.random.default_rng(0))
    vertex_step(data, model)
    model = with_rest_normals(data, model)
    call = problem_of(sequences, frame_importance=counts)
    alignment, moved = fit_all_frames(call, found, data, model, report=lambda _: None)
    every = gather(sequences, bones=4, frame_importance=counts, compress=False)
    inner = alignment.inward(frames, 0, every.frame_scale).reshape(len(model.rest), -1)
    every = dataclasses.replace(
        every, z=inner, x2=(inner**2).sum(axis=1), alignment=alignment, surface=surface
    ).with_normals()
    want = terms.value(every, moved, surface.pose)
    assert Objective().value(every, moved) == pytest.approx(want, rel=1e-7)
    assert want > 1.1 * moved.weighted_error(every)
    before = dataclasses.replace(model.copy(), transforms=model.transforms[found.nearest])
    assert want < 0.9 * terms.value(every, before, surface.pose)


def test_rotations_leap_to_where_they_belong() -> None:
    """Far from the start, sweeps reach more with leaps between them than without."""
    rig = motions.chain(3, bones=4, frames=60)
    data = gather([ssdr.MeshSequence(rig.frames)], bones=4, compress=False)
    rest, exact = motions.in_solver(data, rig.rest, rig.transforms)
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
