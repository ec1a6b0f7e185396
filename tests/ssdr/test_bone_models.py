"""Bones that grow (similarity) and stretch (affine), against naive twins and exact data."""

from __future__ import annotations

import functools
import importlib.util
from pathlib import Path
from typing import Any

import motions
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ssdr
from ssdr import chunked, cli, streaming
from ssdr.affine import solve_affine
from ssdr.model import FREE, Fixed, Model, bone_sums, vertex_step
from ssdr.stretching import AffinePolish, SimilarityPolish, normalise_gauge, polish_of
from ssdr.trajectories import gather

KINDS = ("similarity", "affine")
MODELS = ("rigid", *KINDS)


def stretched(transforms: np.ndarray, kind: str, seed: int = 0, amount: float = 0.3) -> np.ndarray:
    """Rigid transforms with a stretch before them, smooth in time, none in frame 0."""
    rng = np.random.default_rng(seed)
    n_frames, n_bones = transforms.shape[:2]
    wave = np.sin(np.arange(n_frames)[:, None, None, None] * rng.uniform(0.2, 0.7, (n_bones, 3, 3)))
    if kind == "similarity":
        stretch = np.exp(amount * wave[..., :1, :1]) * np.eye(3)
    else:
        stretch = np.eye(3) + amount * wave * np.array([[1, 0.5, 0], [0.5, 1, 0.5], [0, 0.5, 1]])
    out = transforms.copy()
    out[..., :3] = transforms[..., :3] @ stretch
    assert np.linalg.det(out[..., :3]).min() > 0.05
    return out


def rig(kind: str, bones: int = 4, **options: Any) -> motions.Rig:
    """The chain with bones that stretch about their middle."""
    base = motions.chain(bones=bones, **options)
    middle = np.array([[0.0, 0.0, b + 0.5] for b in range(bones)])
    m = stretched(base.transforms, kind)
    m[..., 3] += np.einsum("tjab,jb->tja", base.transforms[..., :3] - m[..., :3], middle)
    return motions.Rig(base.rest, base.joints, base.weights, m, base.faces)


def check_kind(transforms: np.ndarray, kind: str) -> None:
    linear = transforms[..., :3]
    assert (np.linalg.det(linear) > 0).all()
    assert np.isfinite(transforms).all()
    if kind == "affine":
        return
    gram = np.einsum("tjca,tjcb->tjab", linear, linear)
    size = np.trace(gram, axis1=2, axis2=3) / 3
    if kind == "rigid":
        assert np.abs(size - 1).max() < 1e-9
    assert np.abs(gram / size[..., None, None] - np.eye(3)).max() < 1e-9


def pooled(frames: np.ndarray, again: np.ndarray) -> float:
    return float(np.sqrt(((frames - again) ** 2).sum(axis=-1).mean()))


# naive twins


def naive_umeyama(source: np.ndarray, target: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Umeyama 1991, equations 34 to 43, with weights."""
    w = w / w.sum()
    a, b = w @ source, w @ target
    covariance = sum(u * np.outer(t - b, s - a) for u, s, t in zip(w, source, target, strict=True))
    u, d, vt = np.linalg.svd(covariance)
    sign = np.array([1, 1, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    r = u @ np.diag(sign) @ vt
    size = (d * sign).sum() / (w * ((source - a) ** 2).sum(axis=1)).sum()
    return np.concatenate([size * r, (b - size * r @ a)[:, None]], axis=1)


def naive_affine(rest, joints, weights, frame, bones, importance) -> np.ndarray:
    """All bones of one frame by a general least-squares solver on the full design matrix."""
    design = np.zeros((len(rest), 4 * bones))
    for i, p in enumerate(rest):
        for j, w in zip(joints[i], weights[i], strict=True):
            design[i, 4 * j : 4 * j + 4] += w * np.append(p, 1.0)
    root = np.sqrt(importance)[:, None]
    found, *_ = np.linalg.lstsq(root * design, root * frame, rcond=None)
    return found.reshape(bones, 4, 3).transpose(0, 2, 1)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_single_influence_is_umeyama(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rest, importance = rng.standard_normal((24, 3)), 0.1 + rng.random(24)
    joints = np.repeat(np.arange(3), 8)[:, None]
    truth = stretched(motions.motions(rng, 4, 3), "similarity", seed)
    frames = motions.blend(rest, joints, np.ones((24, 1)), truth)
    frames += 0.3 * rng.standard_normal(frames.shape)
    fit = ssdr.fit_bones(
        frames, rest=rest, joints=joints, weights=np.ones((24, 1)), bone_model="similarity",
        vertex_importance=importance, tolerance=1e-10,
    )  # fmt: skip
    check_kind(fit.transforms, "similarity")
    for t in range(4):
        for j in range(3):
            mine = joints[:, 0] == j
            want = naive_umeyama(rest[mine], frames[t, mine], importance[mine])
            np.testing.assert_allclose(fit.transforms[t, j], want, atol=1e-5)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_affine_bones_are_the_least_squares_of_the_design_matrix(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rest, importance = rng.standard_normal((60, 3)), 0.1 + rng.random(60)
    joints, weights = motions.weights_of(rng, 60, 3, 2)
    truth = stretched(motions.motions(rng, 4, 3), "affine", seed)
    frames = motions.blend(rest, joints, weights, truth)
    frames += 0.02 * rng.standard_normal(frames.shape)
    fit = ssdr.fit_bones(
        frames, rest=rest, joints=joints, weights=weights, bone_model="affine",
        vertex_importance=importance, tolerance=1e-12,
    )  # fmt: skip
    for t in range(4):
        want = naive_affine(rest, joints, weights, frames[t], 3, importance)
        np.testing.assert_allclose(fit.transforms[t], want, atol=1e-6)
    assert fit.converged


@pytest.mark.parametrize("kind", KINDS)
def test_fit_bones_finds_the_bones_that_made_the_data(kind: str) -> None:
    truth = rig(kind)
    # a vertex moves with its main bone alone, so that every bone is determined
    joints, weights = truth.joints[:, :1], np.ones((len(truth.rest), 1))
    frames = motions.blend(truth.rest, joints, weights, truth.transforms)
    fit = ssdr.fit_bones(
        frames, rest=truth.rest, joints=joints, weights=weights, bone_model=kind, tolerance=1e-9
    )
    np.testing.assert_allclose(fit.transforms, truth.transforms, atol=1e-5)
    assert fit.rmse < 1e-6


# exact recovery


@pytest.mark.parametrize("kind", KINDS)
def test_data_of_a_kind_are_recovered_by_it_and_not_by_less(kind: str) -> None:
    truth = rig(kind, rows=24)
    frames = truth.frames
    size = float(np.linalg.norm(np.ptp(frames.reshape(-1, 3), axis=0)))
    found = ssdr.decompose(frames, bones=4, bone_model=kind)
    check_kind(found.skinning.transforms, kind)
    assert found.skinning.bone_model == kind
    assert found.rmse == pytest.approx(pooled(frames, found.reconstruct()), rel=1e-6)
    assert found.rmse < 5e-4 * size
    less = ssdr.decompose(frames, bones=4, bone_model=MODELS[MODELS.index(kind) - 1])
    assert less.rmse > 10 * found.rmse


# more freedom never fits worse


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), noise=st.sampled_from([0.0, 0.05, 1.0]))
def test_warm_started_from_the_smaller_model_is_never_worse(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    rest = rng.standard_normal((30, 3))
    joints, weights = motions.weights_of(rng, 30, 3, 3)
    frames = motions.blend(rest, joints, weights, motions.motions(rng, 5, 3))
    frames += noise * rng.standard_normal(frames.shape)
    start, last = None, np.inf
    for kind in MODELS:
        fit = ssdr.fit_bones(
            frames, rest=rest, joints=joints, weights=weights, bone_model=kind,
            transforms=start, locked_bones=None if start is None else [],
        )  # fmt: skip
        check_kind(fit.transforms, kind)
        assert fit.rmse <= last * (1 + 1e-9) + 1e-7
        start, last = fit.transforms, fit.rmse


def test_decompositions_warm_started_along_the_chain_fall() -> None:
    base = rig("affine", bones=3, frames=12)
    frames = motions.wobble(base, 0.03)
    part: dict[str, Any] = {}
    errors = []
    for kind in MODELS:
        result = ssdr.decompose(frames, bones=3, bone_model=kind, effort="fast", **part)
        s = result.skinning
        check_kind(s.transforms, kind)
        errors.append(result.rmse)
        part = {
            "joints": s.joints, "weights": s.weights, "rest": s.rest,
            "transforms": s.transforms, "locked_bones": [],
        }  # fmt: skip
    assert errors[1] <= errors[0]
    assert errors[2] < 0.9 * errors[1]


@pytest.mark.parametrize("kind", KINDS)
def test_more_freedom_pays_on_motion_that_is_of_no_kind(kind: str) -> None:
    frames = motions.wobble(motions.chain(bones=4), 0.2)
    less = MODELS[MODELS.index(kind) - 1]
    errors = [
        ssdr.decompose(frames, bones=4, bone_model=model, effort="fast").rmse
        for model in (less, kind)
    ]
    assert errors[1] < errors[0]


THIN = {
    "wings, 2": (motions.wings, 2), "wings, 4": (motions.wings, 4), "cloth, 4": (motions.cloth, 4),
}  # fmt: skip


@functools.cache
def rigid_on(name: str) -> tuple[np.ndarray, ssdr.Decomposition]:
    """Frames of a thin sheet, and rigid bones that were found for them."""
    make, bones = THIN[name]
    frames, _ = make()
    return frames, ssdr.decompose(frames, bones=bones)


@pytest.mark.parametrize("name", THIN)
@pytest.mark.parametrize("kind", KINDS)
def test_bones_that_stretch_are_no_worse_on_thin_sheets(kind: str, name: str) -> None:
    """There the way to a better affine bone leads through one that is inside out."""
    frames, rigid = rigid_on(name)
    found = ssdr.decompose(frames, bones=rigid.skinning.n_bones, bone_model=kind)
    check_kind(found.skinning.transforms, kind)
    assert found.rmse <= rigid.rmse
    if kind == "affine":
        assert found.rmse <= 0.6 * rigid.rmse


@pytest.mark.parametrize("name", THIN)
@pytest.mark.parametrize("kind", KINDS)
def test_fitted_bones_that_stretch_are_no_worse_on_thin_sheets(kind: str, name: str) -> None:
    frames, result = rigid_on(name)
    model = result.skinning
    parts = {"rest": model.rest, "joints": model.joints, "weights": model.weights}
    rigid, found = (ssdr.fit_bones(frames, bone_model=k, **parts) for k in ("rigid", kind))
    check_kind(found.transforms, kind)
    assert rigid.rmse <= 1.001 * result.rmse  # two of the frames are stuck at first
    assert found.rmse <= rigid.rmse


# what could blow up


def degenerate(name: str) -> np.ndarray:
    rng = np.random.default_rng(0)
    rest = rng.standard_normal((40, 3))
    if name == "planar":
        rest[:, 2] = 0
    elif name == "collinear":
        rest[:, 1:] = 0
    elif name == "coincident":
        rest[:] = rest[0]
    elif name == "few":
        rest = rest[:5]
    n = len(rest)
    m = stretched(motions.motions(rng, 8, 3), "affine")
    frames = motions.blend(rest, rng.integers(0, 3, (n, 1)), np.ones((n, 1)), m)
    if name == "static":
        frames[:] = frames[0]
    elif name == "mirrored":
        frames[4:] *= np.array([1, 1, -1])
    elif name == "flattened":
        frames[3] *= np.array([1, 1, 0])
    elif name == "collapsed":
        frames[5] = frames[5, 0]
    elif name == "noise":
        frames = rng.standard_normal(frames.shape)
    return frames


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "name",
    ["planar", "collinear", "coincident", "few", "static", "mirrored", "flattened", "collapsed",
     "noise"],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::ssdr.SsdrWarning")
def test_degenerate_data_do_not_blow_up(kind: str, name: str) -> None:
    frames = degenerate(name)
    result = ssdr.decompose(frames, bones=3, bone_model=kind, effort="fast")
    check_kind(result.skinning.transforms, kind)
    size = np.linalg.norm(result.skinning.transforms[..., :3], axis=(-2, -1))
    assert size.max() < 60  # 20 √3 and what the gauge makes of it
    spread = np.abs(frames - frames.mean(axis=(0, 1))).max() + 1e-12
    assert np.abs(result.skinning.rest).max() < 100 * (spread + np.abs(frames).max())
    assert result.rmse == pytest.approx(pooled(frames, result.reconstruct()), rel=1e-5, abs=1e-9)
    rigid = ssdr.decompose(frames, bones=3, effort="fast")
    assert result.rmse <= 1.05 * rigid.rmse + 1e-6 * spread


def test_what_a_plane_leaves_open_stays_rigid() -> None:
    """The direction across flat patches is that of the rigid fit: of length 1, upright."""
    rng = np.random.default_rng(1)
    rest = np.concatenate([rng.standard_normal((30, 2)), np.zeros((30, 1))], axis=1)
    joints = np.repeat([[0], [1]], 15, axis=0)
    truth = motions.motions(rng, 6, 2)
    truth[..., 0] *= 1.5
    frames = motions.blend(rest, joints, np.ones((30, 1)), truth)
    fit = ssdr.fit_bones(
        frames, rest=rest, joints=joints, weights=np.ones((30, 1)), bone_model="affine"
    )
    assert fit.rmse < 1e-6
    np.testing.assert_allclose(fit.transforms[..., :2], truth[..., :2], atol=1e-5)
    across = fit.transforms[..., 2]
    assert 0.5 < np.linalg.norm(across, axis=-1).min() <= np.linalg.norm(across, axis=-1).max() < 2
    assert (np.einsum("tja,tja->tj", across, truth[..., 2]) > 0).all()


def test_bones_that_data_turn_inside_out_stop_before_and_still_descend() -> None:
    rng = np.random.default_rng(2)
    rest = rng.standard_normal((40, 3))
    joints, weights = motions.weights_of(rng, 40, 3, 2)
    frames = motions.blend(rest, joints, weights, motions.motions(rng, 6, 3))
    frames[2:] *= np.array([1, 1, -1])
    data = gather([ssdr.MeshSequence(frames)], bones=3)
    inner, m = data.from_world(rest, np.tile(np.eye(4)[:3], (6, 3, 1, 1)))
    assert m is not None
    u, c = bone_sums(data, joints, weights, inner, 3)
    free = np.zeros(3, dtype=bool)
    goal = np.stack([data.frame(t) for t in range(6)])
    values = []
    for _ in range(6):
        solve_affine(m, u, c, free)
        assert (np.linalg.det(m[..., :3]) > 0).all()
        values.append(((motions.blend(inner, joints, weights, m) - goal) ** 2).sum())
    assert (np.diff(values) <= 1e-9 * values[0]).all()
    assert np.linalg.det(m[..., :3]).min() < 0.05  # it did come to the border


# the polish


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("fixed", ["free", "rest", "weights", "bones"])
def test_step_solves_the_dense_reduced_system(kind: str, fixed: str) -> None:
    """The same normal equations from Jacobians by finite differences."""
    rng = np.random.default_rng(3)
    n, bones, n_frames, k = 12, 2, 3, 2
    hold = {
        "free": {}, "rest": {"rest": True}, "weights": {"weights": np.arange(n) % 2 == 0},
        "bones": {"bones": np.array([False, True])},
    }[fixed]  # fmt: skip
    what = Fixed(bone_model=kind, **hold)  # type: ignore[arg-type]
    rest = rng.standard_normal((n, 3))
    joints, weights = motions.weights_of(rng, n, bones, k)
    truth = stretched(motions.motions(rng, n_frames, bones), kind, amount=0.2)
    frames = motions.blend(rest, joints, weights, truth)
    frames += 0.1 * rng.standard_normal(frames.shape)
    data = gather(
        [ssdr.MeshSequence(frames)], bones=99, vertex_importance=0.5 + rng.random(n),
        frame_importance=0.5 + rng.random(n_frames),
    )  # fmt: skip
    inner, start = data.from_world(rest, truth)
    assert start is not None
    model = Model.start(start, inner, joints[:, 0].astype(np.intp), k)
    model.joints[:], model.weights[:] = joints, weights
    model.widen()
    vertex_step(data, model, fixed=what)
    polish = polish_of(data, model, fixed=what)
    assert type(polish) is {"similarity": SimilarityPolish, "affine": AffinePolish}[kind]
    polish.conjugate_steps = 3000
    size = 7 if kind == "similarity" else 12
    keep = what.keep_weights(n)
    free = [(i, q) for i in range(n) for q in range(1, int((model.weights[i] > 0).sum()))
            if not keep[i]]  # fmt: skip
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
        gap = motions.blend(p, model.joints, w, m) - goal
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
    u, _ = bone_sums(data, model.joints, model.weights, model.rest, bones)
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
    assert np.vdot(polish._image(x), g) == pytest.approx(np.vdot(x, polish._pullback(g)), rel=1e-12)
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
    model = Model.start(m, rest, start.joints[:, 0].astype(np.intp), 3)
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
    gap = motions.blend(model.rest, model.joints, model.weights, model.transforms) - goal
    assert (gap**2).sum() == pytest.approx(values[-1], rel=1e-6)


# gauge


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
    model = Model.start(m.copy(), rest, boxes.joints[:, 0].astype(np.intp), 2)
    before = motions.blend(model.rest, model.joints, model.weights, model.transforms)
    importance = 0.5 + rng.random(40)
    normalise_gauge(model, importance, Fixed(bone_model=kind))  # type: ignore[arg-type]
    after = motions.blend(model.rest, model.joints, model.weights, model.transforms)
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


# through the whole package


@pytest.mark.parametrize("kind", KINDS)
def test_same_bits_resumed_and_on_any_number_of_threads(kind: str, tmp_path: Path) -> None:
    frames = motions.wobble(rig(kind, bones=3, frames=12), 0.05)
    options: dict[str, Any] = {"bones": 3, "bone_model": kind, "effort": "fast"}
    count = []
    whole = ssdr.decompose(frames, **options, callback=lambda p: count.append(p.phase))
    seen = []
    stop = ssdr.decompose(
        frames, **options, callback=lambda p: seen.append(p) or len(seen) > len(count) - 3
    )
    assert stop.stop_reason == "cancelled"
    again = ssdr.decompose(frames, **options, resume=stop.state.save(tmp_path / "state.npz"))
    threads = ssdr.get_threads()
    try:
        ssdr.set_threads(2 if threads == 1 else 1)
        other = ssdr.decompose(frames, **options)
    finally:
        ssdr.set_threads(threads)
    for name in ("transforms", "rest", "weights", "joints"):
        want = getattr(whole.skinning, name)
        assert np.array_equal(getattr(again.skinning, name), want), name
        assert np.array_equal(getattr(other.skinning, name), want), name
    with pytest.raises(ssdr.InputError, match="bone_model"):
        ssdr.decompose(frames, **{**options, "bone_model": "rigid"}, resume=stop.state)


@pytest.mark.parametrize("kind", KINDS)
def test_given_parts_stay(kind: str) -> None:
    truth = rig(kind, bones=3)
    frames = motions.wobble(truth, 0.02)
    result = ssdr.decompose(
        frames, bones=3, bone_model=kind, rest=truth.rest, transforms=truth.transforms[:, :2],
        effort="fast",
    )  # fmt: skip
    np.testing.assert_allclose(result.skinning.rest, truth.rest, atol=1e-9)
    np.testing.assert_allclose(
        result.skinning.transforms[:, :2], truth.transforms[:, :2], atol=1e-9
    )
    check_kind(result.skinning.transforms, kind)


@pytest.mark.parametrize("kind", KINDS)
def test_streamed(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streaming, "_IN_MEMORY", 1)
    monkeypatch.setattr(streaming, "_FEWEST", 20)
    monkeypatch.setattr(streaming, "_MOST", 20)
    monkeypatch.setattr(chunked, "_BLOCK", 24 * 120 * 7)
    truth = rig(kind, bones=3, frames=50)
    frames = truth.frames
    result = ssdr.decompose(frames, bones=3, bone_model=kind)
    assert {record.phase for record in result.history} == {"all frames"}
    assert result.rmse == pytest.approx(pooled(frames, result.reconstruct()), rel=1e-6)
    check_kind(result.skinning.transforms, kind)
    rigid = ssdr.decompose(frames, bones=3)
    assert result.rmse < 0.3 * rigid.rmse


@pytest.mark.parametrize("kind", KINDS)
def test_smooth_weights_with_bones_that_stretch(kind: str) -> None:
    truth = rig(kind, bones=3)
    frames = motions.wobble(truth, 0.05)
    result = ssdr.decompose(
        frames, truth.faces, bones=3, bone_model=kind, smoothness=0.05, effort="fast"
    )
    check_kind(result.skinning.transforms, kind)
    rigid = ssdr.decompose(frames, truth.faces, bones=3, smoothness=0.05, effort="fast")
    assert result.rmse < rigid.rmse


@pytest.mark.parametrize("kind", KINDS)
def test_weights_and_rest_pose_of_such_bones(kind: str) -> None:
    truth = rig(kind)
    fit = ssdr.fit_weights(
        truth.frames, rest=truth.rest, transforms=truth.transforms, bone_model=kind
    )
    assert fit.rmse < 1e-5
    pose = ssdr.fit_rest_pose(
        truth.frames, joints=truth.joints, weights=truth.weights, transforms=truth.transforms,
        bone_model=kind,
    )  # fmt: skip
    np.testing.assert_allclose(pose.rest, truth.rest, atol=1e-6)


REFUSED = {
    "rigid, grown": ("rigid", 1.1 * np.eye(3), "off by"),
    "similarity, sheared": ("similarity", np.diag([1, 1, 1.1]), "off by"),
    "similarity, mirrored": ("similarity", np.diag([2, 2, -2.0]), "reflection"),
    "similarity, of size 0": ("similarity", np.zeros((3, 3)), "zeros"),
    "affine, mirrored": ("affine", np.diag([2, 1, -1.0]), "reflection"),
    "affine, flat": ("affine", np.diag([2, 1, 0.0]), "singular"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refuses_transforms_of_another_kind(case: str) -> None:
    kind, linear, why = REFUSED[case]
    m = np.zeros((5, 2, 3, 4))
    m[..., :3] = np.eye(3)
    m[3, 1, :, :3] = linear
    frames = np.random.default_rng(0).standard_normal((5, 20, 3))
    with pytest.raises(ssdr.InputError, match=why) as caught:
        ssdr.decompose(frames, bones=2, transforms=m, bone_model=kind)
    assert caught.value.argument == "transforms"


@pytest.mark.parametrize(
    "call",
    [
        lambda f: ssdr.decompose(f, bones=2, bone_model="soft"),
        lambda f: ssdr.initialize(f, bones=2, bone_model="soft"),
        lambda f: ssdr.fit_bones(
            f, rest=f[0], joints=np.zeros((20, 1), int), weights=np.ones((20, 1)),
            bone_model="soft",
        ),
        lambda f: ssdr.fit_weights(
            f, rest=f[0], transforms=np.zeros((5, 2, 3, 4)), bone_model="soft"
        ),
        lambda f: ssdr.fit_rest_pose(
            f, joints=np.zeros((20, 1), int), weights=np.ones((20, 1)),
            transforms=np.zeros((5, 2, 3, 4)), bone_model="soft",
        ),
    ],
)  # fmt: skip
def test_refuses_an_unknown_kind(call: Any) -> None:
    frames = np.random.default_rng(0).standard_normal((5, 20, 3))
    with pytest.raises(ssdr.InputError, match="affine") as caught:
        call(frames)
    assert caught.value.argument == "bone_model"


# files


def test_similarity_plays_from_files(tmp_path: Path) -> None:
    frames = motions.wobble(rig("similarity", bones=3, frames=10), 0.02)
    sequence = ssdr.MeshSequence(frames, motions.chain(bones=3).faces)
    model = ssdr.decompose(sequence, bones=3, bone_model="similarity", effort="fast").skinning
    size = float(np.ptp(frames.reshape(-1, 3), axis=0).max())
    names = ["m.npz", "m.glb"]
    if importlib.util.find_spec("pxr") is not None:
        names.append("m.usdc")
    for name in names:
        ssdr.save(model, tmp_path / name)
        back = ssdr.load_skinning(tmp_path / name)
        assert back.bone_model == "similarity"
        limit = 1e-3 if name.endswith("usdc") else 1e-5  # UsdSkel holds scales in half precision
        assert np.abs(back.skin() - model.skin()).max() < limit * size


def test_affine_is_kept_by_npz_and_refused_by_joints(tmp_path: Path) -> None:
    frames = motions.wobble(rig("affine", bones=3, frames=10), 0.02)
    sequence = ssdr.MeshSequence(frames, motions.chain(bones=3).faces)
    model = ssdr.decompose(sequence, bones=3, bone_model="affine", effort="fast").skinning
    ssdr.save(model, tmp_path / "m.npz")
    back = ssdr.load_skinning(tmp_path / "m.npz")
    assert back.bone_model == "affine"
    assert np.array_equal(back.transforms, model.transforms)
    with pytest.raises(ssdr.InputError, match="scaled rotations"):
        ssdr.save(model, tmp_path / "m.glb")
    assert not (tmp_path / "m.glb").exists()


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, out = tmp_path / "walk.npz", tmp_path / "model.npz"
    ssdr.save(ssdr.MeshSequence(rig("affine", bones=2, frames=6).frames), source)
    words = ["decompose", str(source), "-b", "2", "-e", "fast", "--bone-model", "affine", "-q"]
    assert cli.main([*words, "-o", str(out)]) == 0
    assert ssdr.load_skinning(out).bone_model == "affine"
    assert cli.main([*words, "-o", str(tmp_path / "model.glb")]) == 2
    assert "cannot shear" in capsys.readouterr().err
