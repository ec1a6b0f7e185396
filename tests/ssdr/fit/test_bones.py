"""Bone transforms for a given rest pose and weights."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import ssdr
from helpers import motions, naive
from helpers.stretches import KINDS, check_kind, rig, stretched
from ssdr.fit import bones


def check_rigid(transforms: np.ndarray) -> None:
    r = transforms[..., :3]
    assert np.abs(np.einsum("tjca,tjcb->tjab", r, r) - np.eye(3)).max() < 1e-9
    assert np.abs(np.linalg.det(r) - 1).max() < 1e-9


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), turn=st.sampled_from([0.1, 1.0, 3.0]))
def test_single_influence_is_kabsch(seed: int, turn: float) -> None:
    rng = np.random.default_rng(seed)
    rest = rng.standard_normal((24, 3))
    indices = np.repeat(np.arange(3), 8)[:, None]
    frames = motions.blend(
        rest, indices, np.ones((24, 1)), motions.motions(rng, 4, 3, turn=turn)
    ) + 0.3 * rng.standard_normal((4, 24, 3))
    fit = ssdr.fit_bones(frames, rest=rest, indices=indices, weights=np.ones((24, 1)))
    check_rigid(fit.transforms)
    for j in range(3):
        mine = indices[:, 0] == j
        expected = ssdr.kabsch(np.broadcast_to(rest[mine], (4, 8, 3)), frames[:, mine])
        np.testing.assert_allclose(fit.transforms[:, j], expected, atol=1e-7)
    assert fit.converged


def test_importance_is_that_of_weighted_kabsch(rng: np.random.Generator) -> None:
    rest, frames = rng.standard_normal((10, 3)), rng.standard_normal((3, 10, 3))
    importance = rng.random(10)
    importance[3] = 0
    fit = ssdr.fit_bones(
        frames,
        rest=rest,
        indices=np.zeros((10, 1), int),
        weights=np.ones((10, 1)),
        vertex_importance=importance,
    )
    for t in range(3):
        expected = ssdr.kabsch(rest, frames[t], importance)
        np.testing.assert_allclose(fit.transforms[t, 0], expected, atol=1e-7)


def test_blended_weights_against_least_squares() -> None:
    """Both reach the same minimum of one frame's 18 unknowns from the same start."""
    rng = np.random.default_rng(11)
    n, bones = 20, 3
    rest = rng.standard_normal((n, 3))
    indices, weights = motions.weights_of(rng, n, bones, 3)
    truth = motions.motions(rng, 2, bones, turn=0.3)
    frames = motions.blend(rest, indices, weights, truth)
    frames += 0.05 * rng.standard_normal(frames.shape)
    fit = ssdr.fit_bones(
        frames,
        rest=rest,
        indices=indices,
        weights=weights,
        transforms=truth,
        locked_bones=[],
        tolerance=1e-12,
        max_sweeps=5000,
    )
    for t in range(2):

        def residual(x: np.ndarray, t: int = t) -> np.ndarray:
            m = x.reshape(bones, 6)
            r = Rotation.from_rotvec(m[:, :3]).as_matrix()
            here = np.concatenate([r, m[:, 3:, None]], axis=-1)[None]
            return (motions.blend(rest, indices, weights, here)[0] - frames[t]).ravel()

        start = np.concatenate(
            [Rotation.from_matrix(truth[t, :, :, :3]).as_rotvec(), truth[t, :, :, 3]], axis=1
        )
        found = least_squares(residual, start.ravel(), xtol=1e-15, ftol=1e-15, gtol=1e-12)
        ours = ((motions.blend(rest, indices, weights, fit.transforms)[t] - frames[t]) ** 2).sum()
        assert ours == pytest.approx(2 * found.cost, rel=1e-6)


def test_every_sweep_descends() -> None:
    rig = motions.chain(bones=5)
    frames = motions.wobble(rig, 0.1)
    errors = [
        ssdr.fit_bones(
            frames,
            rest=rig.rest,
            indices=rig.indices,
            weights=rig.weights,
            max_sweeps=sweeps,
            tolerance=0.0,
        ).rmse
        for sweeps in (1, 2, 3, 4, 8, 16, 50)
    ]
    assert (np.diff(errors) <= 1e-15 * errors[0]).all()  # measured anew: but for rounding
    assert errors[0] > 1.001 * errors[-1]


def test_widely_overlapping_bones_settle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside sweeps alone, and a start at the bones that made the frames."""
    rng = np.random.default_rng(5)
    rest = rng.standard_normal((200, 3))
    indices, weights = np.tile(np.arange(6), (200, 1)), rng.dirichlet(np.full(6, 8.0), size=200)
    truth = motions.motions(rng, 5, 6, turn=0.5)
    frames = motions.blend(rest, indices, weights, truth)
    frames += 0.01 * rng.standard_normal(frames.shape)
    known = {"rest": rest, "indices": indices, "weights": weights}
    fit = ssdr.fit_bones(frames, **known)
    assert fit.converged
    near = ssdr.fit_bones(frames, **known, transforms=truth, locked_bones=[])
    assert fit.rmse == pytest.approx(near.rmse, rel=1e-4)
    monkeypatch.setattr(bones, "_step_together", lambda data, model, fixed, damping: damping)
    monkeypatch.setattr(bones, "_from_neighbours", lambda *_: False)
    swept = ssdr.fit_bones(frames, **known, max_sweeps=fit.sweeps)
    assert not swept.converged
    assert swept.rmse > 1.05 * fit.rmse


def test_new_motion_of_a_known_model() -> None:
    rig = motions.chain(bones=4)
    frames = 100 + motions.chain(bones=4, seed=9).frames
    fit = ssdr.fit_bones(
        frames,
        rig.faces,
        rest=rig.rest,
        indices=rig.indices,
        weights=rig.weights,
        max_sweeps=3000,
        tolerance=1e-9,
    )
    again = motions.blend(rig.rest, rig.indices, rig.weights, fit.transforms)
    assert np.abs(again - frames).max() < 1e-3
    assert fit.rmse == pytest.approx(np.sqrt(((again - frames) ** 2).sum(-1).mean()), rel=1e-6)


def test_order_of_influences_does_not_matter() -> None:
    rig = motions.chain(bones=4)
    frames = motions.wobble(rig)
    one = ssdr.fit_bones(frames, rest=rig.rest, indices=rig.indices, weights=rig.weights)
    other = ssdr.fit_bones(
        frames, rest=rig.rest, indices=rig.indices[:, ::-1], weights=rig.weights[:, ::-1]
    )
    assert other.rmse == pytest.approx(one.rmse, rel=1e-3)


def test_locked_bones_stay() -> None:
    rig = motions.chain(bones=4)
    start = rig.transforms.copy()
    start[:, [0, 2], :, 3] += 0.2
    fit = ssdr.fit_bones(
        rig.frames,
        rest=rig.rest,
        indices=rig.indices,
        weights=rig.weights,
        transforms=start,
        locked_bones=[2],
    )
    np.testing.assert_allclose(fit.transforms[:, 2], start[:, 2], atol=1e-12)
    assert np.abs(fit.transforms[:, 0] - start[:, 0]).max() > 0.05
    free = ssdr.fit_bones(
        rig.frames,
        rest=rig.rest,
        indices=rig.indices,
        weights=rig.weights,
        transforms=start,
        locked_bones=[],
    )
    assert free.rmse < 0.5 * fit.rmse


def test_reflection_gets_a_rotation(rng: np.random.Generator) -> None:
    rest = rng.standard_normal((30, 3))
    frames = np.stack([rest, rest * [1, 1, -1], rest @ motions.rotation(0, 0, 3).T])
    indices, weights = motions.weights_of(rng, 30, 2, 2)
    fit = ssdr.fit_bones(frames, rest=rest, indices=indices, weights=weights)
    check_rigid(fit.transforms)
    assert fit.rmse > 0.1


@pytest.mark.parametrize("axes", [[0], [0, 1]])
def test_collinear_and_planar(axes: list[int], rng: np.random.Generator) -> None:
    rest = np.zeros((12, 3))
    rest[:, axes] = rng.standard_normal((12, len(axes)))
    truth = motions.motions(rng, 5, 1, turn=1.0)
    frames = motions.blend(rest, np.zeros((12, 1), int), np.ones((12, 1)), truth)
    fit = ssdr.fit_bones(
        frames, rest=rest, indices=np.zeros((12, 1), int), weights=np.ones((12, 1))
    )
    check_rigid(fit.transforms)
    assert fit.rmse < 1e-7


def test_bones_without_vertices() -> None:
    rig = motions.chain(bones=3)
    fit = ssdr.fit_bones(
        rig.frames, rest=rig.rest, indices=rig.indices, weights=rig.weights, bones=6
    )
    assert fit.transforms.shape[1] == 6
    check_rigid(fit.transforms)
    assert np.isfinite(fit.transforms).all()


@pytest.mark.parametrize(
    ("argument", "change"),
    [
        ("indices", {"indices": np.full((120, 4), -1)}),
        ("indices", {"indices": np.zeros((120, 4))}),
        ("weights", {"weights": np.full((120, 4), 0.3)}),
        ("weights", {"weights": np.full((120, 4), np.nan)}),
        ("bones", {"bones": 2}),
        ("transforms", {"locked_bones": [0]}),
        ("max_sweeps", {"max_sweeps": 0}),
        ("vertex_importance", {"vertex_importance": np.zeros(120)}),
        ("vertex_importance", {"vertex_importance": -np.ones(120)}),
    ],
)
def test_refuses(argument: str, change: dict[str, object]) -> None:
    rig = motions.chain(bones=5)
    parts = {"rest": rig.rest, "indices": rig.indices, "weights": rig.weights} | change
    with pytest.raises(ssdr.InputError) as caught:
        ssdr.fit_bones(rig.frames, **parts)
    assert caught.value.argument == argument


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_single_influence_is_umeyama(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rest, importance = rng.standard_normal((24, 3)), 0.1 + rng.random(24)
    indices = np.repeat(np.arange(3), 8)[:, None]
    truth = stretched(motions.motions(rng, 4, 3), "similarity", seed)
    frames = motions.blend(rest, indices, np.ones((24, 1)), truth)
    frames += 0.3 * rng.standard_normal(frames.shape)
    fit = ssdr.fit_bones(
        frames,
        rest=rest,
        indices=indices,
        weights=np.ones((24, 1)),
        bone_model="similarity",
        vertex_importance=importance,
        tolerance=1e-10,
    )
    check_kind(fit.transforms, "similarity")
    for t in range(4):
        for j in range(3):
            mine = indices[:, 0] == j
            want = naive.umeyama(rest[mine], frames[t, mine], importance[mine])
            np.testing.assert_allclose(fit.transforms[t, j], want, atol=1e-5)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_affine_bones_are_the_least_squares_of_the_design_matrix(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rest, importance = rng.standard_normal((60, 3)), 0.1 + rng.random(60)
    indices, weights = motions.weights_of(rng, 60, 3, 2)
    truth = stretched(motions.motions(rng, 4, 3), "affine", seed)
    frames = motions.blend(rest, indices, weights, truth)
    frames += 0.02 * rng.standard_normal(frames.shape)
    fit = ssdr.fit_bones(
        frames,
        rest=rest,
        indices=indices,
        weights=weights,
        bone_model="affine",
        vertex_importance=importance,
        tolerance=1e-12,
    )
    for t in range(4):
        want = naive.affine(rest, indices, weights, frames[t], 3, importance)
        np.testing.assert_allclose(fit.transforms[t], want, atol=1e-6)
    assert fit.converged


@pytest.mark.parametrize("kind", KINDS)
def test_fit_bones_finds_the_bones_that_made_the_data(kind: str) -> None:
    truth = rig(kind)
    # a vertex moves with its main bone alone, so that every bone is determined
    indices, weights = truth.indices[:, :1], np.ones((len(truth.rest), 1))
    frames = motions.blend(truth.rest, indices, weights, truth.transforms)
    fit = ssdr.fit_bones(
        frames, rest=truth.rest, indices=indices, weights=weights, bone_model=kind, tolerance=1e-9
    )
    np.testing.assert_allclose(fit.transforms, truth.transforms, atol=1e-5)
    assert fit.rmse < 1e-6
