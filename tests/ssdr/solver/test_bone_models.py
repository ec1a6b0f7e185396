"""Bones that stretch: the polish of similarity and affine bones against dense systems."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.stretches import KINDS, MODELS, check_kind, rig, stretched
from ssdr.solver.alternation import vertex_step
from ssdr.solver.bone_models import AffinePolish, SimilarityPolish, normalise_gauge, polish_of
from ssdr.solver.model import FREE, Fixed, Model
from ssdr.solver.moments import bone_sums
from ssdr.solver.trajectories import gather


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("fixed", ["free", "rest", "weights", "bones"])
def test_step_solves_the_dense_reduced_system(kind: str, fixed: str) -> None:
    """The same normal equations from Jacobians by finite differences."""
    rng = np.random.default_rng(3)
    n, bones, n_frames, k = 12, 2, 3, 2
    hold = {
        "free": {},
        "rest": {"rest": True},
        "weights": {"weights": np.arange(n) % 2 == 0},
        "bones": {"bones": np.array([False, True])},
    }[fixed]
    what = Fixed(bone_model=kind, **hold)  # type: ignore[arg-type]
    rest = rng.standard_normal((n, 3))
    indices, weights = motions.weights_of(rng, n, bones, k)
    truth = stretched(motions.motions(rng, n_frames, bones), kind, amount=0.2)
    frames = motions.blend(rest, indices, weights, truth)
    frames += 0.1 * rng.standard_normal(frames.shape)
    data = gather(
        [ssdr.MeshSequence(frames)],
        bones=99,
        vertex_importance=0.5 + rng.random(n),
        frame_importance=0.5 + rng.random(n_frames),
    )
    inner, start = data.from_world(rest, truth)
    assert start is not None
    model = Model.start(start, inner, indices[:, 0].astype(np.intp), k)
    model.indices[:], model.weights[:] = indices, weights
    model.restart_support()
    vertex_step(data, model, fixed=what)
    polish = polish_of(data, model, fixed=what)
    assert type(polish) is {"similarity": SimilarityPolish, "affine": AffinePolish}[kind]
    polish.conjugate_steps = 3000
    size = 7 if kind == "similarity" else 12
    keep = what.keep_weights(n)
    free = [
        (i, q) for i in range(n) for q in range(1, int((model.weights[i] > 0).sum())) if not keep[i]
    ]
    coordinates = [] if what.rest else [(i, c) for i in range(n) for c in range(3)]
    goal = np.stack([data.frame(t) for t in range(n_frames)])

    def residual(x: np.ndarray, v: np.ndarray) -> np.ndarray:
        m = model.transforms.copy()
        image = polish._image(x.reshape(n_frames, bones, size)).reshape(n_frames, 3, 4, bones)
        m += image.transpose(0, 3, 1, 2) / data.frame_scale[:, None, None, None]
        w, p = model.weights.copy(), model.rest.copy()
        for value, (i, q) in zip(v, free, strict=False):
            w[i, q] += value
            w[i, 0] -= value
        for value, (i, c) in zip(v[len(free) :], coordinates, strict=True):
            p[i, c] += value
        gap = motions.blend(p, model.indices, w, m) - goal
        return (gap * np.sqrt(data.importance)[:, None] * data.frame_scale[:, None, None]).ravel()

    n_m, n_v = n_frames * bones * size, len(free) + len(coordinates)
    both = np.zeros((n_m + n_v, len(goal.ravel())))
    for j in range(n_m + n_v):
        e = np.zeros(n_m + n_v)
        e[j] = 1e-5
        both[j] = (residual(e[:n_m], e[n_m:]) - residual(-e[:n_m], -e[n_m:])) / 2e-5
    j_m, j_v = both[:n_m].T, both[n_m:].T
    moving = ~np.tile(np.repeat(what.locked(bones), size), n_frames)
    r = residual(np.zeros(n_m), np.zeros(n_v))
    lift = j_m.T @ j_v @ np.linalg.inv(j_v.T @ j_v)
    a, right = j_m.T @ j_m - lift @ j_v.T @ j_m, -(j_m.T @ r - lift @ (j_v.T @ r))
    polish.damping = 0.1
    u, _ = bone_sums(data, model.indices, model.weights, model.rest, bones)
    _, damp = polish._preconditioner(u)
    shape = (n_frames, bones, size)
    extra = np.stack([damp(e.reshape(shape)).ravel() for e in np.eye(n_m)])
    np.testing.assert_allclose(extra, extra.T, atol=1e-12)
    some = np.ix_(moving, moving)
    assert np.linalg.eigvalsh(extra[some]).min() > 0
    want = np.zeros(n_m)
    want[moving] = np.linalg.solve((a + extra)[some], right[moving])
    got, predicted = polish._solve()
    np.testing.assert_allclose(got.ravel(), want, atol=2e-3 * np.abs(want).max())
    assert predicted == pytest.approx(2 * right @ want - want @ a @ want, rel=1e-3)


@pytest.mark.parametrize("kind", MODELS)
def test_image_pullback_and_move_belong_together(kind: str) -> None:
    rng = np.random.default_rng(4)
    frames = motions.wobble(motions.chain(bones=3, frames=6), 0.1)
    data = gather([ssdr.MeshSequence(frames)], bones=3, frame_importance=0.5 + rng.random(6))
    m = stretched(motions.motions(rng, 6, 3), kind if kind != "rigid" else "affine", amount=0.2)
    if kind == "rigid":
        m = motions.motions(rng, 6, 3)
    locked = np.array([False, True, False])
    model = Model.start(m, data.frame(0), np.arange(data.n_vertices) % 3, 2)
    polish = polish_of(data, model, fixed=Fixed(bones=locked, bone_model=kind))  # type: ignore[arg-type]
    x = rng.standard_normal((6, 3, polish.generators.shape[2]))
    g = rng.standard_normal((18, 12))
    back = np.vdot(x, polish._pullback(g))
    for precision, rounding in ((polish.precision, 1e-6), (np.float64, 1e-12)):
        polish.precision = precision
        assert np.vdot(polish._image(x), g) == pytest.approx(back, rel=rounding)
    x[:, locked] = 0
    ends = []
    for sign in (1, -1):
        moved = m.copy()
        polish._move(moved, sign * 1e-6 * np.where(locked[:, None], 1.0, x))
        check_kind(moved, kind)
        assert np.array_equal(moved[:, locked], m[:, locked])
        ends.append(data.hat(moved))
    np.testing.assert_allclose(polish._image(x), (ends[0] - ends[1]) / 2e-6, atol=1e-7)


@pytest.mark.parametrize("kind", KINDS)
def test_polish_descends_and_keeps_the_kind(kind: str) -> None:
    frames = motions.wobble(rig(kind, bones=3, frames=10), 0.1)
    start = ssdr.initialize(frames, bones=3, bone_model=kind)
    assert start.bone_model == kind
    data = gather([ssdr.MeshSequence(frames)], bones=3)
    rest, m = data.from_world(start.rest, start.transforms)
    assert m is not None
    model = Model.start(m, rest, start.indices[:, 0].astype(np.intp), 3)
    fixed = Fixed(bone_model=kind)  # type: ignore[arg-type]
    vertex_step(data, model, fixed=fixed)
    polish = polish_of(data, model, fixed=fixed)
    values = [polish.value]
    for k in range(10):
        polish.step(entering=3 if k % 3 == 0 else 0)
        values.append(polish.value)
    assert (np.diff(values) <= 0).all()
    assert values[-1] < 0.9 * values[0]
    check_kind(model.transforms, kind)
    goal = np.stack([data.frame(t) for t in range(10)])
    gap = motions.blend(model.rest, model.indices, model.weights, model.transforms) - goal
    assert (gap**2).sum() == pytest.approx(values[-1], rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_gauge_moves_nothing_and_makes_the_mean_stretch_one(kind: str) -> None:
    rng = np.random.default_rng(5)
    boxes = motions.boxes(2, points=20)
    m = stretched(boxes.transforms, kind)
    # two parts, each in a gauge of its own
    skew = (
        np.array([[3.0, 0, 0], [0, 2.0, 0.4], [0, 0, 0.5]]) if kind == "affine" else 3 * np.eye(3)
    )
    rest = boxes.rest.copy()
    rest[:20] = rest[:20] @ skew.T
    m[:, 0, :, :3] = m[:, 0, :, :3] @ np.linalg.inv(skew)
    model = Model.start(m.copy(), rest, boxes.indices[:, 0].astype(np.intp), 2)
    before = motions.blend(model.rest, model.indices, model.weights, model.transforms)
    importance = 0.5 + rng.random(40)
    normalise_gauge(model, importance, Fixed(bone_model=kind))  # type: ignore[arg-type]
    after = motions.blend(model.rest, model.indices, model.weights, model.transforms)
    np.testing.assert_allclose(after, before, atol=1e-9)
    linear = model.transforms[..., :3]
    mean = np.einsum("tjca,tjcb->jab", linear, linear) / len(linear)
    if kind == "affine":
        np.testing.assert_allclose(mean, np.tile(np.eye(3), (2, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.trace(mean, axis1=1, axis2=2), 3, atol=1e-9)
    check_kind(model.transforms, kind)
    np.testing.assert_allclose(  # parts stay where they were
        model.rest[:20].mean(axis=0), rest[:20].mean(axis=0), atol=1e-9
    )
    again = model.copy()
    for held in (FREE, Fixed(bone_model="affine", rest=True), Fixed(bones=np.zeros(2, bool))):
        normalise_gauge(again, importance, held)
        assert np.array_equal(again.rest, model.rest)


def test_result_is_in_that_gauge() -> None:
    result = ssdr.decompose(rig("affine").frames, bones=4, bone_model="affine", effort="fast")
    s = result.skinning
    mass = np.asarray(s.sparse_weights().sum(axis=0)).ravel()
    linear = s.transforms[..., :3]
    mean = np.einsum("j,tjca,tjcb->ab", mass / mass.sum(), linear, linear) / len(linear)
    np.testing.assert_allclose(mean, np.eye(3), atol=1e-6)
