"""The polish against dense Jacobians by finite differences on a tiny problem."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import motions, naive
from helpers.tiny import Tiny
from ssdr.solver.alternation import vertex_step
from ssdr.solver.model import FREE, Fixed, Model
from ssdr.solver.polish import Polish
from ssdr.solver.trajectories import gather

CASES = {
    "free": FREE,
    "rest": Fixed(rest=True),
    "weights": Fixed(weights=np.arange(8) % 2 == 0),
    "all weights": Fixed(weights=np.ones(8, dtype=bool)),
    "bones": Fixed(bones=np.array([False, True, False])),
    "rest and weights": Fixed(rest=True, weights=np.ones(8, dtype=bool)),
}


@pytest.fixture(params=CASES, ids=str)
def tiny(request: pytest.FixtureRequest) -> Tiny:
    return Tiny(3, fixed=CASES[request.param])


def reduced_system(tiny: Tiny) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Schur complement, right-hand side and diagonal from the dense Jacobians."""
    r, j_m, j_v = tiny.jacobians()
    locked = np.repeat(tiny.fixed.locked(tiny.bones), 6)
    j_m = j_m * ~np.tile(locked, tiny.frames)
    a, g = j_m.T @ j_m, j_m.T @ r
    if j_v.shape[1]:
        lift = j_m.T @ j_v @ np.linalg.inv(j_v.T @ j_v)
        a, g = a - lift @ j_v.T @ j_m, g - lift @ (j_v.T @ r)
    return a, -g, (j_m**2).sum(axis=0)


@pytest.mark.parametrize("damping", [1e-3, 0.3])
def test_step_solves_the_dense_reduced_system(tiny: Tiny, damping: float) -> None:
    a, right, diagonal = reduced_system(tiny)
    free = diagonal > 0
    system = a + damping * np.diag(diagonal)
    want = np.zeros(len(right))
    want[free] = np.linalg.solve(system[np.ix_(free, free)], right[free])
    tiny.polish.damping = damping
    got, predicted = tiny.polish._solve()
    size = np.abs(want).max()
    assert size > 0
    np.testing.assert_allclose(got.ravel(), want, atol=2e-3 * size)
    decrease = 2 * right @ want - want @ a @ want
    assert predicted == pytest.approx(decrease, rel=1e-3)


def test_single_precision_changes_a_step_by_rounding_alone(tiny: Tiny) -> None:
    polish, found = tiny.polish, []
    for precision in (np.float32, np.float64):
        polish.precision, polish._left.grouped, polish.recycled = precision, None, None
        x, predicted = polish._solve()
        grouped = polish._left.grouped
        assert grouped is not None
        assert grouped.inverse.dtype == precision
        assert x.dtype == np.float64
        found.append((x, predicted, polish._back_substitute(x)))
    (x, predicted, answer), (want_x, want_predicted, want_answer) = found
    np.testing.assert_allclose(x, want_x, atol=1e-3 * np.abs(want_x).max())
    np.testing.assert_allclose(answer, want_answer, atol=1e-3 * np.abs(want_answer).max())
    assert predicted == pytest.approx(want_predicted, rel=1e-5)


def test_gradient_is_that_of_the_objective(tiny: Tiny) -> None:
    """With all the damping in the world the step is the gradient over the diagonal."""
    _, right, diagonal = reduced_system(tiny)
    tiny.polish.damping = 1e9
    got, _ = tiny.polish._solve()
    gradient = got.ravel() * 1e9 * diagonal
    np.testing.assert_allclose(gradient, right, atol=1e-5 * np.abs(right).max())


def test_back_substitution_is_the_best_answer_of_the_vertices(tiny: Tiny) -> None:
    """Given the bones' step, v = -(JvᵀJv)⁻¹ Jvᵀ (r + Jm x)."""
    r, j_m, j_v = tiny.jacobians()
    x = 0.01 * np.random.default_rng(1).standard_normal((tiny.frames, tiny.bones, 6))
    x[:, tiny.fixed.locked(tiny.bones)] = 0
    step = tiny.polish._back_substitute(x)
    got = np.zeros(j_v.shape[1])
    slot: dict[int, int] = {}
    for k, (i, _) in enumerate(tiny.freedoms()):
        got[k] = -step[i, slot.get(i, 0)]
        slot[i] = slot.get(i, 0) + 1
    want = np.zeros(0)
    if j_v.shape[1]:
        want = -np.linalg.solve(j_v.T @ j_v, j_v.T @ (r + j_m @ x.ravel()))
    np.testing.assert_allclose(got, want, atol=1e-5 * max(np.abs(want).max(initial=0), 1e-3))
    for i in range(tiny.n):
        assert (step[i, slot.get(i, 0) :] == 0).all()


def test_steps_descend_and_leave_what_is_fixed(tiny: Tiny) -> None:
    model = tiny.model
    before = model.copy()
    values = [tiny.polish.value]
    for k in range(12):
        accepted = tiny.polish.step(entering=3 if k % 3 == 0 else 0)
        values.append(tiny.polish.value)
        assert accepted or values[-1] == values[-2]
        assert model.objective(tiny.data) == pytest.approx(values[-1], rel=1e-12)
    assert (np.diff(values) <= 0).all()
    assert values[-1] < 0.99 * values[0]
    inner = np.stack([tiny.data.frame(t) for t in range(tiny.frames)])
    scaled = inner * tiny.data.frame_scale[:, None, None]
    m = model.transforms * tiny.data.frame_scale[:, None, None, None]
    want = naive.squared_error(scaled, model.rest, model.indices, model.weights, m)
    np.testing.assert_allclose(model.error, want, rtol=1e-8, atol=1e-12)
    keep = tiny.fixed.keep_weights(tiny.n)
    assert np.array_equal(model.weights[keep], before.weights[keep])
    assert np.array_equal(model.indices[keep], before.indices[keep])
    if tiny.fixed.rest:
        assert np.array_equal(model.rest, before.rest)
    locked = tiny.fixed.locked(tiny.bones)
    assert np.array_equal(model.transforms[:, locked], before.transforms[:, locked])
    assert model.weights.min() >= 0
    assert np.abs(model.weights.sum(axis=1) - 1).max() < 1e-12


def test_exact_data_converges_fast() -> None:
    """Gauss–Newton on a problem of no residual: a few steps take it from a percent to rounding."""
    rig = motions.chain(bones=4, rows=24, frames=12)
    data = gather([ssdr.MeshSequence(rig.frames)], bones=4)
    rest, transforms = data.from_world(rig.rest, rig.transforms)
    assert transforms is not None
    rng = np.random.default_rng(0)
    transforms[..., 3] += 0.02 * rng.standard_normal(transforms[..., 3].shape)
    model = Model.start(transforms, rest, rig.indices[:, 0].astype(np.intp), 4)
    vertex_step(data, model)
    polish = Polish(data, model)
    first = np.sqrt(polish.value)
    for _ in range(25):
        polish.step(entering=3)
    assert np.sqrt(polish.value) < 1e-3 * first


def test_resumed_polish_goes_on_to_the_bit() -> None:
    whole, parts = Tiny(5), Tiny(5)
    for k in range(6):
        whole.polish.step(entering=3 if k % 3 == 0 else 0)
    for k in range(6):
        parts.polish.step(entering=3 if k % 3 == 0 else 0)
        parts.polish = Polish(
            parts.data,
            parts.model,
            damping=parts.polish.damping,
            recycled=parts.polish.recycled,
            conjugate_steps=2000,
        )
    for name in ("transforms", "rest", "indices", "weights", "error"):
        assert np.array_equal(getattr(whole.model, name), getattr(parts.model, name)), name
