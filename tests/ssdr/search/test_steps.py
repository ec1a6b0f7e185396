"""Trials of changes: whose turn it is; the step that unfolds a rest pose."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions, naive
from helpers.blends import BONES, INFLUENCES, problem
from helpers.measures import descent_of, solved
from ssdr.search import steps
from ssdr.search.descent import Descent, step
from ssdr.search.moves import polish_steps
from ssdr.search.steps import STEPS_OF_A_TRIAL, tried, unfold
from ssdr.solver.model import SOLVED, Constraints, Model
from ssdr.solver.objective import Objective, WeightSmoothness
from ssdr.solver.rest_surface import RestSurface
from ssdr.solver.trajectories import gather
from ssdr.solver.vertex_newton import optimise_some, optimise_vertices


def searched(paying: set[int], *, steps: int) -> tuple[list[int], Descent]:
    """Which of four changes were tried, where those named lower the objective by 1 %."""
    data, model = problem(6)
    drawn: list[int] = []

    def change(kind: int) -> Any:
        def changed(_: object, model: Model, *others: object) -> Model:
            drawn.append(kind)
            return model.copy()

        return changed

    def polished_value(d: Descent, trial: Model, base: float) -> float:
        trial.error *= 0.99 if drawn[-1] in paying else 1.01
        return d.value(trial)

    @step("search")
    def counted(d: Descent) -> Iterator[None]:
        changes = tuple(change(kind) for kind in range(4))
        return tried(d, changes, polished_value, steps=steps, success=1e-3)

    d = descent_of(data, BONES, INFLUENCES)
    d.model = model
    d.follow(counted)
    assert d.work.iteration == STEPS_OF_A_TRIAL * len(drawn)
    successes = sum(kind in paying for kind in drawn)
    assert d.value(d.model) == pytest.approx(0.99**successes * d.value(model), rel=1e-9)
    return drawn, d


def test_changes_that_pay_have_more_turns() -> None:
    drawn, _ = searched({0, 1, 2, 3}, steps=40)
    assert drawn == 10 * [0, 1, 2, 3]
    drawn, _ = searched({2}, steps=400)
    share = np.bincount(drawn[40:], minlength=4) / 360
    # seven times as many, and none is given up for good
    assert share[2] == pytest.approx(0.7, abs=0.01)
    assert np.delete(share, 2) == pytest.approx([0.1] * 3, abs=0.01)


@pytest.mark.parametrize("steps", [1, 3, 7])
def test_a_search_without_a_success_has_converged(steps: int) -> None:
    assert searched(set(), steps=steps)[1].converged
    assert not searched({0}, steps=steps)[1].converged


def folded(*, smoothness: float = 0.0) -> Descent:
    """A descent whose best model has two triangles of the rest pose turned over."""
    rig = motions.chain(bones=3, rows=16, ring=8, frames=10)
    data = gather([ssdr.MeshSequence(motions.wobble(rig, 0.05), rig.faces)], bones=3)
    data = dataclasses.replace(data, surface=RestSurface.build(data.faces, data.frame(0)))
    model = solved(data, 3)
    model.rest[60] += 1.5 * (model.rest[61] - model.rest[60])
    optimise_vertices(data, model, constraints=Constraints(lock_rest=True), entering=0)
    d = descent_of(data, 3)
    d.smoothness = WeightSmoothness.build(data, data.faces, smoothness)
    d.objective = Objective(Constraints(), d.smoothness)
    d.begin_with(model)
    return d


def flipped(d: Descent) -> int:
    """Number of triangles of the best rest pose against their vertices' normals, one by one."""
    rest, count = d.best.model.rest, 0
    normals = naive.corner_normals(rest, d.data.faces)
    for corners, face in zip(normals, rest[d.data.faces], strict=True):
        count += np.cross(face[1] - face[0], face[2] - face[0]) @ corners.sum(axis=0) < 0
    return count


@pytest.mark.parametrize("smoothness", [0.0, 0.1])
def test_triangles_that_are_turned_over_turn_back(smoothness: float) -> None:
    d = folded(smoothness=smoothness)
    before, surface = d.best.model.copy(), d.data.surface
    assert 0 < flipped(d) < 6
    d.follow(unfold)
    assert flipped(d) == 0
    assert d.records[-1][2:] == (d.best_error, "unfold")
    # it is the model that is returned, and what follows keeps to the stiffer edges
    assert d.best.value == pytest.approx(d.value(d.best.model), rel=1e-12)
    assert d.data.surface is not surface
    far = np.linalg.norm(before.rest - before.rest[60], axis=1) > 1.5
    np.testing.assert_allclose(d.best.model.rest[far], before.rest[far], atol=0.02)
    if smoothness:  # the solve would not know of it
        np.testing.assert_array_equal(d.best.model.weights, before.weights)


@pytest.mark.parametrize("given_back", [True, False])
def test_what_costs_too_much_is_polished_and_then_given_up(
    given_back: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    d = folded()
    # the frames of the folded model itself, with some noise: any other rest pose costs error
    model, rng = d.best.model, np.random.default_rng(0)
    frames = naive.skin(model.rest, model.indices, model.weights, model.transforms)
    frames += 1e-3 * rng.standard_normal(frames.shape)
    data = gather([ssdr.MeshSequence(frames, d.data.faces)], bones=3)
    d = descent_of(dataclasses.replace(data, surface=d.data.surface), 3)
    d.begin_with(model)
    polish_steps(d.data, d.model, 20, Constraints())
    d.begin_with(d.model)
    before, least = d.best.model.copy(), d.best_error
    assert 0 < flipped(d) < 6

    def polished(data: Any, trial: Model, *others: object, entering: bool) -> None:
        assert trial.weighted_error(data) > 1.02**2 * least
        if given_back:
            trial.error *= least / trial.weighted_error(data)

    monkeypatch.setattr(steps, "polish_steps", polished)
    d.follow(unfold)
    assert (flipped(d) == 0) == given_back
    assert d.best_error <= 1.02**2 * least
    if not given_back:
        np.testing.assert_array_equal(d.best.model.rest, before.rest)


def test_some_vertices_are_solved_as_all_are_and_the_others_stay() -> None:
    d = folded()
    before, data = d.best.model, d.data
    every, few = before.copy(), before.copy()
    rows = np.arange(0, data.n_vertices, 3)
    optimise_vertices(data, every, constraints=Constraints(), entering=3)
    assert data.surface is not None
    options: Any = {"constraints": Constraints(), "entering": 3, "times": 1}
    optimise_some(data, few, rows, data.surface, **options)
    for name in SOLVED:
        want = getattr(before, name).copy()
        want[rows] = getattr(every, name)[rows]
        np.testing.assert_allclose(getattr(few, name), want, rtol=1e-7, atol=1e-9)
    assert np.abs(few.rest - before.rest).max() > 1e-4


def test_a_rest_pose_without_folds_or_surface_stays_as_it_is() -> None:
    for surface in (True, False):
        d = folded()
        model = d.best.model.copy()
        if surface:
            assert d.data.surface is not None
            model.rest = d.data.surface.pose.copy()
        else:
            d.data = dataclasses.replace(d.data, surface=None)
        d.begin_with(model)
        d.follow(unfold)
        np.testing.assert_array_equal(d.best.model.rest, model.rest)
        np.testing.assert_array_equal(d.best.model.weights, model.weights)
