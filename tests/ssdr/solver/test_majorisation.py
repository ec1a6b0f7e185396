"""No step that knows pulls on the rest pose and normals raises the objective (Hunter and Lange)."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pytest

from helpers import terms
from helpers.measures import descent_of
from helpers.terms import Case
from ssdr.search.descent import Descent
from ssdr.search.steps import alternate
from ssdr.solver.alternation import repeat_alternation, vertex_step
from ssdr.solver.gauss_newton import GaussNewton
from ssdr.solver.model import FREE, Constraints, Model
from ssdr.solver.objective import Objective, WeightSmoothness, rest_pulls
from ssdr.solver.trajectories import Trajectories
from ssdr.solver.vertex_newton import optimise_vertices

LOCKED = Constraints(weights=np.arange(30) % 3 == 0)
CASES = {
    "surface": Case(normals=False),
    "normals": Case(surface=False),
    "both": Case(),
    "slack": Case(slack=5.0),
    "importance": Case(counts="some"),
    "vertices that do not count": Case(counts="few"),
    "compressed": Case(compressed=True),
    "compressed, importance": Case(compressed=True, counts="some"),
    "locked": Case(constraints=LOCKED),
    "locked rest pose": Case(constraints=Constraints(lock_rest=True)),
}
STEPS = {
    "vertex step": lambda data, model, constraints: vertex_step(
        data, model, constraints=constraints
    ),
    "alternation": lambda data, model, constraints: repeat_alternation(data, model, 1, constraints),
    "vertices": lambda data, model, constraints: optimise_vertices(
        data, model, constraints=constraints
    ),
    "polish": lambda data, model, constraints: GaussNewton(
        data, model, constraints=constraints
    ).step(entering=1),
}


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("case", CASES)
def test_no_step_raises_the_objective(case: str, step: str) -> None:
    chosen = CASES[case]
    objective, fell = Objective(chosen.constraints), 0.0
    for seed in range(3):
        small = {} if chosen.compressed else {"n": 30, "frames": 8}
        data, model = terms.problem(chosen, seed, **small)
        value = first = objective.value(data, model)
        for _ in range(6):
            STEPS[step](data, model, chosen.constraints)
            before, value = value, objective.value(data, model)
            assert value <= before * (1 + 1e-12)
        fell = max(fell, 1 - value / first)
        _check_errors(data, model)
    assert fell > 1e-3


@pytest.mark.parametrize("case", ["surface", "normals", "both", "importance", "compressed"])
def test_no_alternation_raises_it_with_a_penalty_on_weights(case: str) -> None:
    chosen, fell = CASES[case], 0.0
    for seed in range(3):
        small = {} if chosen.compressed else {"n": 30, "frames": 8}
        data, model = terms.problem(chosen, seed, **small)
        d = descent_of(data, 3, 3)
        penalty = WeightSmoothness.build(data, data.faces, 0.3)
        d.smoothness, d.objective = penalty, Objective(FREE, penalty)
        d.begin_with(model)
        assert d.best.value > 1.05 * Objective().value(data, model)
        values = [d.best.value]

        def after_step(_: str, d: Descent = d, values: list[float] = values) -> None:
            values.append(d.value(d.model))

        d.follow(partial(alternate, steps=8), after_step)
        assert (np.diff(values) <= 1e-12 * values[0]).all()
        fell = max(fell, 1 - values[-1] / values[0])
    assert fell > 1e-3


def _check_errors(data: Trajectories, model: Model) -> None:
    """What steps say of their errors is what vertices and normals are off."""
    if data.q is not None:
        return
    counts = data.frame_scale[:, None] ** 2
    frames = np.stack([data.frame(t) for t in range(data.n_frames)])
    parts = model.indices, model.weights, model.transforms
    gap = terms.naive.skin(model.rest, *parts) - frames
    np.testing.assert_allclose(model.error, (counts * (gap**2).sum(axis=2)).sum(axis=0), rtol=1e-7)
    if model.normals.shape[1]:
        gap = terms.turned_normals(model.normals[:, 0], *parts)
        gap -= terms.frame_normals(frames, data.faces)
        want = (counts * (gap**2).sum(axis=2)).sum(axis=0)
        np.testing.assert_allclose(model.normal_error, want, rtol=1e-6)


@pytest.mark.parametrize("constraints", [FREE, LOCKED], ids=["free", "locked"])
def test_gradients_are_those_at_the_rest_pose_where_a_solve_ends(constraints: Constraints) -> None:
    """The pulls go with the rest pose; only their stiffness is that from before the solve."""
    data, model = terms.problem(Case(normals=False, counts="some"), n=30, frames=8)
    before = rest_pulls(data, model, constraints)
    found = optimise_vertices(data, model, constraints=constraints)
    again = optimise_vertices(data, model, constraints=constraints, entering=-1, rounds=0)
    after = rest_pulls(data, model, constraints)
    assert np.abs(after - before).max() > 1e-3
    softer = (after[:, 0] - before[:, 0])[:, None] * (model.rest - after[:, 1:])
    keep = constraints.vertex_mask(30)
    for i in range(30):
        first = 0 if keep[i] else np.count_nonzero(model.weights[i]) - 1
        want = again.gradient[i].copy()
        want[first : first + 3] -= softer[i]
        np.testing.assert_allclose(found.gradient[i], want, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("share", [0.0, 2.0])
def test_vertices_end_where_the_product_is_least(share: float) -> None:
    """With a constant `share` of the error added, as a penalty on weights that stay."""
    data, model = terms.problem(Case(counts="some"), n=30, frames=8)
    stay = Constraints(weights=np.ones(30, dtype=bool))
    penalty = share * model.weighted_error(data)
    for _ in range(400):
        vertex_step(data, model, constraints=stay, penalty=penalty)
    factor = (model.weighted_error(data) + penalty) / model.weighted_error(data)
    surface = data.surface
    assert surface is not None

    def slopes(name: str, i: int, c: int) -> tuple[float, float]:
        """Of the logarithm of the product, and of the error of positions alone."""
        ends = []
        for sign in (1e-5, -1e-5):
            moved = model.copy()
            getattr(moved, name)[i].ravel()[c] += sign
            plain = dataclasses.replace(moved, normals=moved.normals[:, :0])
            error = terms.value(data, plain)
            others = terms.value(data, moved, surface.pose) / error
            ends.append((np.log((error + penalty) * others), np.log(error) / factor))
        return tuple((ends[0][k] - ends[1][k]) / 2e-5 for k in (0, 1))

    for i in (0, 11, 23):
        for c in range(3):
            product, alone = slopes("rest", i, c)
            assert abs(product) < 1e-3 * max(abs(alone), 1e-2)
            assert abs(slopes("normals", i, c)[0]) < 1e-5
