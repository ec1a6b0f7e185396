"""The polish against dense Jacobians by finite differences on a tiny problem."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ssdr
from helpers import motions, naive
from ssdr.solver.alternation import vertex_step
from ssdr.solver.model import FREE, Fixed, Model
from ssdr.solver.polish import Polish
from ssdr.solver.trajectories import Trajectories, gather


class Tiny:
    """A small fitted model, its residual as a function of all unknowns, and the Jacobian."""

    def __init__(self, seed: int = 0, *, fixed: Fixed = FREE, importance: bool = True) -> None:
        rng = np.random.default_rng(seed)
        self.n, self.bones, self.frames, self.k = 8, 3, 4, 3
        rest = rng.standard_normal((self.n, 3))
        joints, weights = motions.weights_of(rng, self.n, self.bones, self.k)
        truth = motions.motions(rng, self.frames, self.bones)
        frames = motions.blend(rest, joints, weights, truth)
        frames += 0.1 * rng.standard_normal(frames.shape)
        self.data: Trajectories = gather(
            [ssdr.MeshSequence(frames)],
            bones=99,
            vertex_importance=0.5 + rng.random(self.n) if importance else None,
            frame_importance=0.5 + rng.random(self.frames) if importance else None,
        )
        assert self.data.q is None
        inner, start = self.data.from_world(rest, truth)
        assert start is not None
        start[..., 3] += 0.05 * rng.standard_normal(start[..., 3].shape)
        self.model = Model.start(start, inner, joints[:, 0].astype(np.intp), self.k)
        self.model.joints[:], self.model.weights[:] = joints, weights
        self.model.restart_support()
        self.fixed = fixed
        vertex_step(self.data, self.model, fixed=fixed)
        self.polish = Polish(self.data, self.model, fixed=fixed, conjugate_steps=2000)

    def freedoms(self) -> list[tuple[int, int]]:
        """(vertex, variable): weights of the support but the first, then x, y, z."""
        keep = self.fixed.keep_weights(self.n)
        out = []
        for i in range(self.n):
            used = int((self.model.weights[i] > 0).sum())
            out += [(i, q) for q in range(1, used) if not keep[i]]
            if not self.fixed.rest:
                out += [(i, -c) for c in (3, 2, 1)]
        return out

    def residual(self, tangents: np.ndarray, vertex: np.ndarray) -> np.ndarray:
        x = tangents.reshape(self.frames, self.bones, 6)
        turn = Rotation.from_rotvec(x[..., :3].reshape(-1, 3)).as_matrix()
        m = self.model.transforms
        moved = np.empty_like(m)
        moved[..., :3] = m[..., :3] @ turn.reshape(self.frames, self.bones, 3, 3)
        moved[..., 3] = m[..., 3] + np.einsum("tjab,tjb->tja", m[..., :3], x[..., 3:])
        rest, weights = self.model.rest.copy(), self.model.weights.copy()
        for value, (i, variable) in zip(vertex, self.freedoms(), strict=True):
            if variable > 0:
                weights[i, variable] += value
                weights[i, 0] -= value
            else:
                rest[i, variable] += value
        inner = np.stack([self.data.frame(t) for t in range(self.frames)])
        gap = motions.blend(rest, self.model.joints, weights, moved) - inner
        gap *= np.sqrt(self.data.importance)[None, :, None]
        gap *= self.data.frame_scale[:, None, None]
        return gap.ravel()

    def jacobians(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residual and its derivatives by the tangents and by the vertices' freedoms."""
        m0, v0 = np.zeros(self.frames * self.bones * 6), np.zeros(len(self.freedoms()))
        step = 1e-5

        def column(k: int, first: bool) -> np.ndarray:
            e = np.zeros(len(m0 if first else v0))
            e[k] = step
            if first:
                return (self.residual(e, v0) - self.residual(-e, v0)) / (2 * step)
            return (self.residual(m0, e) - self.residual(m0, -e)) / (2 * step)

        j_m = np.stack([column(k, True) for k in range(len(m0))], axis=1)
        if len(v0) == 0:
            return self.residual(m0, v0), j_m, np.zeros((len(j_m), 0))
        j_v = np.stack([column(k, False) for k in range(len(v0))], axis=1)
        return self.residual(m0, v0), j_m, j_v


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
    want = naive.squared_error(scaled, model.rest, model.joints, model.weights, m)
    np.testing.assert_allclose(model.error, want, rtol=1e-8, atol=1e-12)
    keep = tiny.fixed.keep_weights(tiny.n)
    assert np.array_equal(model.weights[keep], before.weights[keep])
    assert np.array_equal(model.joints[keep], before.joints[keep])
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
    model = Model.start(transforms, rest, rig.joints[:, 0].astype(np.intp), 4)
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
            parts.data, parts.model, damping=parts.polish.damping, conjugate_steps=2000
        )
    for name in ("transforms", "rest", "joints", "weights", "error"):
        assert np.array_equal(getattr(whole.model, name), getattr(parts.model, name)), name
