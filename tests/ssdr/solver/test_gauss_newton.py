"""Gauss–Newton steps of every bone model against dense Jacobians by finite differences."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ssdr
from helpers import motions, naive, terms, trees
from helpers.stretches import check_kind
from helpers.tiny import CASES, KINDS, TREES, Tiny
from ssdr.model.transforms import joint_gaps
from ssdr.model.tree import Tree
from ssdr.search.trees.placement import snap_to_joints
from ssdr.solver.alternation import vertex_step
from ssdr.solver.gauss_newton import GaussNewton
from ssdr.solver.model import FREE, Model
from ssdr.solver.tangents import chain
from ssdr.solver.trajectories import gather
from ssdr.solver.vertex_newton import optimise_vertices

_OF_TREES = ("joints", "motion alone")
CHOSEN = [
    *((kind, case) for kind in KINDS for case in CASES if case not in _OF_TREES),
    *((tree, case) for tree in TREES for case in CASES),
    *(("rigid", case, "surface and normals") for case in CASES if case not in _OF_TREES),
    ("rigid", "free", "surface"),
    ("rigid", "free", "normals"),
    ("affine", "free", "surface"),
    ("tree", "free", "surface and normals"),
]


@pytest.fixture(params=CHOSEN, ids=" ".join)
def tiny(request: pytest.FixtureRequest) -> Tiny:
    return Tiny(*request.param)


def test_step_solves_the_dense_reduced_system(tiny: Tiny) -> None:
    r, j_m, j_v = tiny.jacobians()
    newton = tiny.newton
    a, right = j_m.T @ j_m, -(j_m.T @ r)
    if j_v.shape[1]:
        lift = j_m.T @ j_v @ np.linalg.inv(j_v.T @ j_v)
        a, right = a - lift @ j_v.T @ j_m, right + lift @ (j_v.T @ r)
    newton.damping = 1e-2
    system = newton._reduced()
    _, damp = newton.tangent.precondition(system.u, newton.damping)
    damped = np.stack([damp(tiny.shaped(e)).ravel() for e in np.eye(len(right))])
    np.testing.assert_allclose(damped, damped.T, atol=1e-12)
    assert np.linalg.eigvalsh(damped).min() > 0
    want = np.linalg.solve(a + damped, right)
    got, predicted = newton._solve(system)
    np.testing.assert_allclose(got.ravel(), want, atol=2e-3 * np.abs(want).max())
    factor = newton.value / (tiny.model.weighted_error(tiny.data) + tiny.data.slack)
    assert predicted == pytest.approx(factor * (2 * right @ want - want @ a @ want), rel=1e-3)


def test_steps_descend_and_leave_what_is_fixed(tiny: Tiny) -> None:
    model, newton = tiny.model, tiny.newton
    before = model.copy()
    values = [newton.value]
    for k in range(12):
        accepted = newton.step(entering=3 if k % 3 == 0 else 0)
        values.append(newton.value)
        assert accepted or values[-1] == values[-2]
        assert newton.objective.value(tiny.data, model) == pytest.approx(values[-1], rel=1e-12)
    assert (np.diff(values) <= 0).all()
    assert values[-1] < 0.99 * values[0]
    surface = None if tiny.constraints.lock_rest else tiny.data.surface
    pose = None if surface is None else surface.pose
    assert terms.value(tiny.data, model, pose) == pytest.approx(values[-1], rel=1e-7)
    inner = np.stack([tiny.data.frame(t) for t in range(tiny.frames)])
    scaled = inner * tiny.data.frame_scale[:, None, None]
    m = model.transforms * tiny.data.frame_scale[:, None, None, None]
    want = naive.squared_error(scaled, model.rest, model.indices, model.weights, m)
    np.testing.assert_allclose(model.error, want, rtol=1e-8, atol=1e-12)
    keep = tiny.constraints.vertex_mask(tiny.n)
    assert np.array_equal(model.weights[keep], before.weights[keep])
    assert np.array_equal(model.indices[keep], before.indices[keep])
    assert model.weights.min() >= 0
    assert np.abs(model.weights.sum(axis=1) - 1).max() < 1e-12
    if tiny.constraints.lock_rest:
        assert np.array_equal(model.rest, before.rest)
    check_kind(model.transforms, tiny.constraints.bone_model)
    if model.tree is not None:
        assert joint_gaps(model.transforms, model.tree.parents, model.tree.points).max() < 1e-13
        if tiny.constraints.lock_joints:
            assert np.array_equal(model.tree.points, before.tree.points)


@pytest.mark.parametrize("kind", ["rigid", "tree"])
@pytest.mark.parametrize("more", ["surface", "normals", "surface and normals", "normals and slack"])
def test_the_gradient_is_that_of_the_objective(kind: str, more: str) -> None:
    """With vertices at their optimum, by finite differences of the whole product."""
    tiny = Tiny(kind, more=more)
    for _ in range(400):
        optimise_vertices(tiny.data, tiny.model, constraints=FREE, entering=0)
    newton = tiny.gauss_newton(damping=1.0)
    factor = newton.value / (tiny.model.weighted_error(tiny.data) + tiny.data.slack)
    got = 2 * factor * newton.tangent.pullback(newton._reduced().gradient).ravel()
    surface = tiny.data.surface
    pose = None if surface is None else surface.pose
    want = np.zeros(12)
    chosen = np.linspace(0, tiny.unknowns - 1, len(want)).round().astype(int)
    for k, j in enumerate(chosen):
        ends = []
        for sign in (1e-5, -1e-5):
            moved = dataclasses.replace(
                tiny.model, transforms=tiny.moved(sign * np.eye(tiny.unknowns)[j])
            )
            ends.append(terms.value(tiny.data, moved, pose))
        want[k] = (ends[0] - ends[1]) / 2e-5
    np.testing.assert_allclose(got[chosen], want, atol=1e-4 * np.abs(want).max())


def test_single_precision_changes_a_step_by_rounding_alone() -> None:
    found = []
    for precision in (np.float32, np.float64):
        newton = Tiny().newton
        newton.tangent.precision = precision
        system = newton._reduced()
        x, predicted = newton._solve(system)
        image = newton.tangent.image(x)
        assert (image.dtype, x.dtype) == (precision, np.float64)
        found.append((x, predicted, system.best_step(image)))
    (x, predicted, answer), (want_x, want_predicted, want_answer) = found
    np.testing.assert_allclose(x, want_x, atol=1e-3 * np.abs(want_x).max())
    np.testing.assert_allclose(answer, want_answer, atol=1e-3 * np.abs(want_answer).max())
    assert predicted == pytest.approx(want_predicted, rel=1e-5)


def _near_exact(frames: int) -> tuple:
    """A tree that moves exactly, its joints a little off."""
    made = trees.skeleton(6, frames, seed=4)
    data = gather([ssdr.MeshSequence(made.frames)], bones=6)
    rest, transforms = motions.in_solver(data, made.rest, made.transforms)
    points = data.alignment.points_from_world(made.points, "joint_positions")
    model = Model.with_weights(transforms.copy(), rest, made.indices, made.weights, 2)
    points = points + 0.03 * np.random.default_rng(0).normal(size=points.shape)
    model.tree = Tree(made.parents, points, rigid=False)
    snap_to_joints(data, model, FREE)
    return data, model


def _near_exact_free() -> tuple:
    rig = motions.chain(bones=4, rows=24, frames=12)
    data = gather([ssdr.MeshSequence(rig.frames)], bones=4)
    rest, transforms = motions.in_solver(data, rig.rest, rig.transforms)
    rng = np.random.default_rng(0)
    transforms[..., 3] += 0.02 * rng.standard_normal(transforms[..., 3].shape)
    model = Model.start(transforms, rest, rig.indices[:, 0].astype(np.intp), 4)
    vertex_step(data, model)
    return data, model


@pytest.mark.parametrize("case", ["free", "tree", "tree in few groups"])
def test_exact_data_converges_fast(monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    """Without a residual a few steps lead from a percent to rounding."""
    if case == "tree in few groups":
        monkeypatch.setattr(chain, "_MEMORY", 0)
    data, model = _near_exact_free() if case == "free" else _near_exact(60)
    newton = GaussNewton(data, model)
    first = np.sqrt(newton.value)
    for _ in range(25 if case == "free" else 40):
        newton.step(entering=3)
    assert np.sqrt(newton.value) < 2e-3 * first


@pytest.mark.parametrize("kind", ["rigid", "tree"])
def test_one_made_from_damping_and_directions_goes_on_to_the_bit(kind: str) -> None:
    whole, parts = Tiny(kind, seed=5), Tiny(kind, seed=5)
    for k in range(6):
        for tiny in (whole, parts):
            tiny.newton.step(entering=3 if k % 3 == 0 else 0)
        old = parts.newton
        parts.newton = parts.gauss_newton(damping=old.damping)
        parts.newton.recycled = old.recycled
    for name in ("transforms", "rest", "indices", "weights", "error"):
        assert np.array_equal(getattr(whole.model, name), getattr(parts.model, name)), name
    if kind == "tree":
        assert np.array_equal(whole.model.tree.points, parts.model.tree.points)
