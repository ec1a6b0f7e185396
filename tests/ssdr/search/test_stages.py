"""The stage of search: whose turn it is, and when it ends; the stage that unfolds a rest pose."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.blends import BONES, INFLUENCES, problem
from helpers.measures import run_of, solved
from ssdr.search.run import Run
from ssdr.search.stages import STEPS_OF_A_TRIAL, Alternate, Search, Unfold
from ssdr.search.starts import StartFromMotion
from ssdr.solver.model import SOLVED, Locked, Model
from ssdr.solver.objective import Objective
from ssdr.solver.rest_surface import RestSurface
from ssdr.solver.smoothness import WeightSmoothness
from ssdr.solver.trajectories import gather
from ssdr.solver.vertex_newton import optimise_some, optimise_vertices


def searched(paying: set[int], *, steps: int, patience: int = 400) -> tuple[list[int], Run]:
    """Which of four changes were tried, where those named lower the objective by 1 %."""
    data, model = problem(6)
    drawn: list[int] = []

    def change(kind: int) -> Any:
        def changed(_: object, model: Model, *others: object) -> Model:
            drawn.append(kind)
            return model.copy()

        return changed

    class Counted(Search):
        changes = tuple(change(kind) for kind in range(4))

        def polished_value(self, run: Run, trial: Model, base: float) -> float:
            trial.error *= 0.99 if drawn[-1] in paying else 1.01
            return run.value(trial)

    run = run_of(data, [Counted(steps=steps, patience=patience)], BONES, INFLUENCES)
    run.model = model
    run.drive()
    assert run.iteration == STEPS_OF_A_TRIAL * len(drawn)
    successes = sum(kind in paying for kind in drawn)
    assert run.value(run.present) == pytest.approx(0.99**successes * run.value(model), rel=1e-9)
    return drawn, run


def test_changes_that_pay_have_more_turns() -> None:
    drawn, _ = searched({0, 1, 2, 3}, steps=40)
    assert drawn == 10 * [0, 1, 2, 3]
    drawn, _ = searched({2}, steps=400)
    share = np.bincount(drawn[40:], minlength=4) / 360
    # seven times as many, and none is given up for good
    assert share[2] == pytest.approx(0.7, abs=0.01)
    assert np.delete(share, 2) == pytest.approx([0.1] * 3, abs=0.01)


@pytest.mark.parametrize("patience", [1, 3, 7])
def test_a_search_ends_after_so_many_failures_in_a_row(patience: int) -> None:
    drawn, run = searched(set(), steps=20, patience=patience)
    assert len(drawn) == patience
    assert run.converged
    # a success begins the count anew: each fourth trial is one
    drawn, run = searched({0}, steps=20, patience=4)
    assert len(drawn) == 20
    assert not run.converged


def folded(*, smoothness: float = 0.0) -> Run:
    """A run whose best model has two triangles of the rest pose turned over."""
    rig = motions.chain(bones=3, rows=16, ring=8, frames=10)
    data = gather([ssdr.MeshSequence(motions.wobble(rig, 0.05), rig.faces)], bones=3)
    data = dataclasses.replace(data, surface=RestSurface.build(data, data.frame(0)))
    model = solved(data, 3, schedule=[StartFromMotion(), Alternate(steps=8)])
    model.rest[60] += 1.5 * (model.rest[61] - model.rest[60])
    optimise_vertices(data, model, locked=Locked(rest=True), entering=0)
    run = run_of(data, [Unfold()], 3)
    run.smoothness = WeightSmoothness.build(data, data.faces, smoothness)
    run.objective = Objective(Locked(), run.smoothness)
    run.begin_with(model)
    return run


@pytest.mark.parametrize("smoothness", [0.0, 0.1])
def test_triangles_that_are_turned_over_turn_back(smoothness: float) -> None:
    run = folded(smoothness=smoothness)
    before, surface = run.best_model.copy(), run.whole.surface
    assert surface is not None
    turned = surface.turned(before.rest, run.whole.faces)
    assert 0 < turned.sum() < 6
    run.drive()
    assert not surface.turned(run.best_model.rest, run.whole.faces).any()
    # it is the model that is returned, and what follows keeps to the stiffer edges
    assert run.best_value == pytest.approx(run.value(run.best_model), rel=1e-12)
    assert run.whole.surface is run.data.surface is not surface
    far = np.linalg.norm(before.rest - before.rest[60], axis=1) > 1.5
    np.testing.assert_allclose(run.best_model.rest[far], before.rest[far], atol=0.02)
    if smoothness:  # the solve would not know of it
        np.testing.assert_array_equal(run.best_model.weights, before.weights)


def test_some_vertices_are_solved_as_all_are_and_the_others_stay() -> None:
    run = folded()
    before, data = run.best_model, run.data
    every, few = before.copy(), before.copy()
    rows = np.arange(0, data.n_vertices, 3)
    optimise_vertices(data, every, entering=0)
    optimise_some(data, few, rows, locked=Locked(), times=1)
    for name in SOLVED:
        want = getattr(before, name).copy()
        want[rows] = getattr(every, name)[rows]
        np.testing.assert_allclose(getattr(few, name), want, rtol=1e-7, atol=1e-9)
    assert np.abs(few.rest - before.rest).max() > 1e-4


def test_a_rest_pose_without_folds_or_surface_stays_as_it_is() -> None:
    for surface in (True, False):
        run = folded()
        model = run.best_model.copy()
        if surface:
            assert run.whole.surface is not None
            model.rest = run.whole.surface.pose.copy()
        else:
            run.whole = run.data = dataclasses.replace(run.whole, surface=None)
        run.begin_with(model)
        run.drive()
        np.testing.assert_array_equal(run.best_model.rest, model.rest)
        np.testing.assert_array_equal(run.best_model.weights, model.weights)
