"""The objective and its penalty on joints away from where skin meets."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.measures import diagonal
from ssdr.model.tree import Tree
from ssdr.search.trees.placement import snap_to_joints
from ssdr.solver.gauss_newton import GaussNewton
from ssdr.solver.model import FREE, Constraints, Model
from ssdr.solver.objective import Objective, joint_offsets, mean_joint_penalty, meeting_points
from ssdr.solver.trajectories import gather

NEAR = Constraints(near_skin=True)


class Smoothness:
    """A penalty of 3."""

    def penalty(self, _: Model) -> float:
        return 3.0


def _model(rng: np.random.Generator, frames: int = 6):
    """A chain of four bones with overlapping weights, one of which moves nothing."""
    rig = motions.chain(1, bones=3, frames=frames)
    data = gather([ssdr.MeshSequence(rig.frames)], bones=4)
    rest, moves = motions.in_solver(data, rig.rest, rig.transforms)
    moves = np.concatenate([moves, moves[:, :1]], axis=1)
    model = Model.with_weights(moves, rest, rig.indices, rig.weights, rig.indices.shape[1])
    points = np.array([rest[rig.indices[:, 0] == min(b, 2)].min(axis=0) for b in range(4)])
    points += 0.1 * rng.standard_normal(points.shape)
    model.tree = Tree(np.array([-1, 0, 1, 0]), points, rigid=False)
    snap_to_joints(data, model, FREE)
    return data, model


def _by_loops(model: Model) -> tuple[np.ndarray, np.ndarray]:
    dense = np.zeros((len(model.rest), model.n_bones))
    for i, (indices, weights) in enumerate(zip(model.indices, model.weights, strict=True)):
        for j, w in zip(indices, weights, strict=True):
            dense[i, j] += w
    points, apart = model.tree.points.copy(), np.zeros(model.n_bones)
    for b, a in enumerate(model.tree.parents):
        mass = (dense**2).sum(axis=0)
        if a < 0 or not mass[a] > 0 or not mass[b] > 0:
            continue
        both = dense[:, a] * dense[:, b]
        centres = [(dense[:, k] ** 2) @ model.rest / mass[k] for k in (a, b)]
        near = both.sum() / np.sqrt(mass[a] * mass[b])
        near = near / (near + 0.01)
        middle = 0.5 * (centres[0] + centres[1])
        shared = both @ model.rest / both.sum() if both.sum() > 0 else middle
        points[b] = near * shared + (1 - near) * middle
        apart[b] = (1 - near) * 0.5 * np.linalg.norm(centres[0] - centres[1])
    return points, apart


def _penalty(model: Model) -> float:
    """Mean of d² + d⁴ of the joints, by loops."""
    points, apart = _by_loops(model)
    terms = []
    for b, a in enumerate(model.tree.parents):
        if a >= 0:
            squared = ((model.tree.points[b] - points[b]) ** 2).sum() + apart[b] ** 2
            terms.append(squared + squared**2)
    return float(np.mean(terms))


def test_meeting_points_and_offsets_against_loops(rng: np.random.Generator) -> None:
    _, model = _model(rng)
    points, apart = meeting_points(model)
    want = _by_loops(model)
    np.testing.assert_allclose(points, want[0], atol=1e-12)
    np.testing.assert_allclose(apart, want[1], atol=1e-12)
    assert apart[3] == 0.0  # it moves nothing
    offsets, squared = joint_offsets(model)
    np.testing.assert_allclose(offsets, model.tree.points - points, atol=1e-12)
    assert mean_joint_penalty(squared[1:]) == pytest.approx(_penalty(model))
    assert mean_joint_penalty(squared[:0]) == 0


def test_the_objective_is_error_and_smoothness_times_penalty(rng: np.random.Generator) -> None:
    data, model = _model(rng)
    error = float((data.importance * model.error).sum())
    assert Objective().value(data, model) == pytest.approx(error)
    want = error * (1 + _penalty(model))
    assert Objective(NEAR).value(data, model) == pytest.approx(want)
    assert Objective(FREE, Smoothness()).value(data, model) == pytest.approx(error + 3)
    both = (error + 3) * (1 + _penalty(model))
    assert Objective(NEAR, Smoothness()).value(data, model) == pytest.approx(both)
    alone = dataclasses.replace(model, tree=None)
    assert Objective(NEAR).value(data, alone) == pytest.approx(error)
    away = dataclasses.replace(model.tree, points=model.tree.points + 1)
    assert Objective(NEAR).value(data, dataclasses.replace(model, tree=away)) > want


def test_steps_lower_the_objective(rng: np.random.Generator) -> None:
    data, model = _model(rng, frames=12)
    newton = GaussNewton(data, model, constraints=NEAR)
    value = newton.value
    accepted = 0
    for _ in range(8):
        accepted += newton.step(entering=1)
        assert newton.value <= value
        value = newton.value
        assert value == pytest.approx(Objective(NEAR).value(data, model), rel=1e-9)
    assert accepted


def test_the_quadratic_model_has_the_derivative_of_the_penalty(rng: np.random.Generator) -> None:
    """By one joint at a time, the error and the meeting points as they are."""
    data, model = _model(rng)
    tree, h, joints = model.tree, 1e-5, model.tree.non_roots
    found = Objective(NEAR).joint_penalty(data, model, joints)
    assert found.factor == pytest.approx(1 + _penalty(model))
    for k, joint in enumerate(joints):
        for d in range(3):
            ends = []
            for sign in (h, -h):
                points = tree.points.copy()
                points[joint, d] += sign
                moved = dataclasses.replace(tree, points=points)
                ends.append(Objective(NEAR).value(data, dataclasses.replace(model, tree=moved)))
            slope = (ends[0] - ends[1]) / (2 * h)
            want = 2 * found.factor * found.stiffness[k, 0] * found.offsets[k, d]
            assert want == pytest.approx(slope, rel=1e-5)
    assert (Objective().joint_penalty(data, model, joints).stiffness == 0).all()


def test_a_hinge_has_its_joint_where_skin_meets() -> None:
    """Both bones turn about one axis: its whole line would do as well."""
    rig = motions.chain(0, bones=2, frames=16)
    frames = motions.wobble(rig, 0.003)
    frames[..., 1] = rig.frames[..., 1]
    model = ssdr.decompose(frames, bones=2, rig="rigid", effort="balanced").skinning
    child = int(np.flatnonzero(model.parents >= 0)[0])
    both = model.dense_weights().prod(axis=1)
    meet = both @ model.rest / both.sum()
    assert np.linalg.norm(model.joint_positions[child] - meet) < 0.1 * diagonal(frames)
