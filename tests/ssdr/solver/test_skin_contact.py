"""Where skin meets, by loops, and joints that are drawn there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.measures import diagonal
from ssdr.hierarchy.tree import Tree
from ssdr.joints.placement import hang
from ssdr.solver.chain_polish import ChainPolish
from ssdr.solver.model import FREE, Fixed, Model
from ssdr.solver.skin_contact import PULL, judged, meeting_points, stray
from ssdr.solver.trajectories import gather

NEAR = Fixed(near_skin=True)


def _model(rng: np.random.Generator, frames: int = 6):
    """A chain of four bones with overlapping weights, one of which moves nothing."""
    rig = motions.chain(1, bones=3, frames=frames)
    data = gather([ssdr.MeshSequence(rig.frames)], bones=4)
    rest, moves = data.from_world(rig.rest, rig.transforms)
    moves = np.concatenate([moves, moves[:, :1]], axis=1)
    model = Model.with_weights(moves, rest, rig.indices, rig.weights, rig.indices.shape[1])
    points = np.array([rest[rig.indices[:, 0] == min(b, 2)].min(axis=0) for b in range(4)])
    points += 0.1 * rng.standard_normal(points.shape)
    model.tree = Tree(np.array([-1, 0, 1, 0]), points, rigid=False)
    hang(data, model, FREE)
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


def test_meeting_points_against_loops(rng: np.random.Generator) -> None:
    _, model = _model(rng)
    points, apart = meeting_points(model)
    want = _by_loops(model)
    np.testing.assert_allclose(points, want[0], atol=1e-12)
    np.testing.assert_allclose(apart, want[1], atol=1e-12)
    assert apart[3] == 0.0  # it moves nothing


def test_the_objective_grows_with_the_distance(rng: np.random.Generator) -> None:
    data, model = _model(rng)
    assert judged(data, model, FREE) == model.objective(data)
    at_skin = dataclasses.replace(model.tree, points=meeting_points(model)[0])
    there = dataclasses.replace(model, tree=at_skin)
    assert stray(there) < stray(model)
    away = dataclasses.replace(model, tree=dataclasses.replace(at_skin, points=at_skin.points + 1))
    grown = stray(away) - stray(there)
    apart = meeting_points(there)[1][1:3] ** 2  # of three joints one is where it should be
    want = ((3.0 + apart) * (4.0 + apart) - apart * (1.0 + apart)).sum() / 3
    assert grown == pytest.approx(want)
    assert judged(data, away, NEAR) == pytest.approx(
        model.objective(data) * (1 + PULL * stray(away))
    )


def test_steps_lower_what_is_judged(rng: np.random.Generator) -> None:
    data, model = _model(rng, frames=12)
    polish = ChainPolish(data, model, fixed=NEAR)
    assert polish.value == pytest.approx(judged(data, model, NEAR), rel=1e-9)
    before, accepted = polish.value, 0
    for _ in range(8):
        accepted += polish.step(entering=1)
        assert polish.value <= before
        before = polish.value
    assert accepted
    assert polish.value == pytest.approx(judged(data, model, NEAR), rel=1e-9)


def test_the_spring_is_the_derivative(rng: np.random.Generator) -> None:
    data, model = _model(rng)
    polish = ChainPolish(data, model, fixed=NEAR)
    with ssdr.parallel.serial_blas():
        polish._solve()
    # of PULL φ P / factor by one joint, the error and the meeting points as they are
    tree, h = model.tree, 1e-5
    meet, apart = meeting_points(model)

    def spread(points: np.ndarray) -> float:
        hung = tree.hung
        squared = ((points - meet)[hung] ** 2).sum(axis=1) + apart[hung] ** 2
        return float((squared + squared**2).mean())

    factor = 1 + PULL * stray(model)
    for k, joint in enumerate(polish.movable):
        for d in range(3):
            up, down = tree.points.copy(), tree.points.copy()
            up[joint, d] += h
            down[joint, d] -= h
            slope = PULL * model.objective(data) * (spread(up) - spread(down)) / (2 * h) / factor
            assert polish._spring[k, 0] * polish._away[k, d] == pytest.approx(0.5 * slope, rel=1e-5)


def test_a_hinge_has_its_joint_where_skin_meets() -> None:
    """Both bones turn about one axis: its whole line would do as well."""
    rig = motions.chain(0, bones=2, frames=16)
    frames = motions.wobble(rig, 0.003)
    frames[..., 1] = rig.frames[..., 1]
    model = ssdr.decompose(frames, bones=2, hierarchy="rigid", effort="balanced").skinning
    child = int(np.flatnonzero(model.parents >= 0)[0])
    both = model.dense_weights().prod(axis=1)
    meet = both @ model.rest / both.sum()
    assert np.linalg.norm(model.joint_positions[child] - meet) < 0.1 * diagonal(frames)
