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
from helpers.stretches import KINDS, MODELS, check_kind, rig, stretched
from ssdr.fit import fit_bones


@settings(max_examples=20)
@given(
    seed=st.integers(0, 10**6),
    turn=st.sampled_from([0.1, 1.0, 3.0]),
    kind=st.sampled_from(["rigid", "similarity"]),
)
def test_single_influence_is_kabsch_or_umeyama(seed: int, turn: float, kind: str) -> None:
    rng = np.random.default_rng(seed)
    rest, importance = rng.standard_normal((24, 3)), 0.1 + rng.random(24)
    importance[::8] = 0.0
    indices = np.repeat(np.arange(3), 8)[:, None]
    truth = motions.motions(rng, 4, 3, turn=turn)
    if kind == "similarity":
        truth = stretched(truth, kind, seed)
    frames = motions.blend(rest, indices, np.ones((24, 1)), truth)
    frames += 0.3 * rng.standard_normal(frames.shape)
    fit = ssdr.fit_bones(
        frames,
        motions.model(rest, indices, np.ones((24, 1))),
        bone_model=kind,
        vertex_importance=importance,
        tolerance=1e-10,
    )
    found = fit.skinning.transforms
    check_kind(found, kind)
    for t in range(4):
        for j in range(3):
            mine = indices[:, 0] == j
            parts = rest[mine], frames[t, mine], importance[mine]
            want = ssdr.kabsch(*parts) if kind == "rigid" else naive.umeyama(*parts)
            tolerance = 1e-7 if kind == "rigid" else 1e-5
            np.testing.assert_allclose(found[t, j], want, atol=tolerance)
    assert fit.converged


def test_blended_weights_against_least_squares() -> None:
    """Both reach the same minimum of one frame's 18 unknowns from the same start."""
    rng = np.random.default_rng(11)
    n, count = 20, 3
    rest = rng.standard_normal((n, 3))
    indices, weights = motions.weights_of(rng, n, count, 3)
    truth = motions.motions(rng, 2, count, turn=0.3)
    frames = motions.blend(rest, indices, weights, truth)
    frames += 0.05 * rng.standard_normal(frames.shape)
    fit = ssdr.fit_bones(
        frames,
        motions.model(rest, indices, weights, truth),
        from_transforms=True,
        tolerance=1e-12,
        max_sweeps=5000,
    )
    for t in range(2):

        def residual(x: np.ndarray, t: int = t) -> np.ndarray:
            m = x.reshape(count, 6)
            r = Rotation.from_rotvec(m[:, :3]).as_matrix()
            here = np.concatenate([r, m[:, 3:, None]], axis=-1)[None]
            return (motions.blend(rest, indices, weights, here)[0] - frames[t]).ravel()

        start = np.concatenate(
            [Rotation.from_matrix(truth[t, :, :, :3]).as_rotvec(), truth[t, :, :, 3]], axis=1
        )
        found = least_squares(residual, start.ravel(), xtol=1e-15, ftol=1e-15, gtol=1e-12)
        here = motions.blend(rest, indices, weights, fit.skinning.transforms)[t]
        assert ((here - frames[t]) ** 2).sum() == pytest.approx(2 * found.cost, rel=1e-6)


def test_every_sweep_descends() -> None:
    chain = motions.chain(bones=5)
    frames = motions.wobble(chain, 0.1)
    errors = [
        ssdr.fit_bones(frames, chain.skinning, max_sweeps=sweeps, tolerance=0.0).rmse
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
    model = motions.model(rest, indices, weights, truth)
    fit = ssdr.fit_bones(frames, model)
    assert fit.converged
    near = ssdr.fit_bones(frames, model, from_transforms=True)
    assert fit.rmse == pytest.approx(near.rmse, rel=1e-4)
    monkeypatch.setattr(fit_bones.GaussNewton, "run", lambda *_, **options: None)
    monkeypatch.setattr(fit_bones, "_from_neighbours", lambda *_: False)
    swept = ssdr.fit_bones(frames, model, max_sweeps=fit.sweeps)
    assert not swept.converged
    assert swept.rmse > 1.05 * fit.rmse


def test_new_motion_of_a_known_model() -> None:
    chain = motions.chain(bones=4)
    frames = 100 + motions.chain(bones=4, frames=27, seed=9).frames
    sequence = ssdr.MeshSequence(frames, chain.faces, 60, name="run")
    fit = ssdr.fit_bones(sequence, chain.skinning, max_sweeps=3000, tolerance=1e-9)
    again = motions.blend(chain.rest, chain.indices, chain.weights, fit.skinning.transforms)
    assert np.abs(again - frames).max() < 1e-3
    assert fit.rmse == pytest.approx(np.sqrt(((again - frames) ** 2).sum(-1).mean()), rel=1e-6)
    assert fit.skinning.clips == (ssdr.Clip("run", 0, 27, 60.0),)
    for name in ("rest", "indices", "weights", "faces"):
        assert np.array_equal(getattr(fit.skinning, name), getattr(chain, name))


def test_order_of_influences_does_not_matter() -> None:
    chain = motions.chain(bones=4)
    frames = motions.wobble(chain)
    one = ssdr.fit_bones(frames, chain.skinning)
    turned = motions.model(chain.rest, chain.indices[:, ::-1], chain.weights[:, ::-1], bones=4)
    assert ssdr.fit_bones(frames, turned).rmse == pytest.approx(one.rmse, rel=1e-3)


def test_reflection_gets_a_rotation(rng: np.random.Generator) -> None:
    rest = rng.standard_normal((30, 3))
    frames = np.stack([rest, rest * [1, 1, -1], rest @ motions.rotation(0, 0, 3).T])
    indices, weights = motions.weights_of(rng, 30, 2, 2)
    fit = ssdr.fit_bones(frames, motions.model(rest, indices, weights))
    check_kind(fit.skinning.transforms, "rigid")
    assert fit.rmse > 0.1


@pytest.mark.parametrize("axes", [[0], [0, 1]])
def test_collinear_and_planar(axes: list[int], rng: np.random.Generator) -> None:
    rest = np.zeros((12, 3))
    rest[:, axes] = rng.standard_normal((12, len(axes)))
    truth = motions.motions(rng, 5, 1, turn=1.0)
    frames = motions.blend(rest, np.zeros((12, 1), int), np.ones((12, 1)), truth)
    fit = ssdr.fit_bones(frames, motions.model(rest))
    check_kind(fit.skinning.transforms, "rigid")
    assert fit.rmse < 1e-7


def test_bones_without_vertices() -> None:
    chain = motions.chain(bones=3)
    model = motions.model(chain.rest, chain.indices, chain.weights, bones=6)
    fit = ssdr.fit_bones(chain.frames, model)
    assert fit.skinning.n_bones == 6
    check_kind(fit.skinning.transforms, "rigid")


@settings(max_examples=15)
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
        motions.model(rest, indices, weights, bone_model="affine"),
        vertex_importance=importance,
        tolerance=1e-12,
    )
    for t in range(4):
        want = naive.affine(rest, indices, weights, frames[t], 3, importance)
        np.testing.assert_allclose(fit.skinning.transforms[t], want, atol=1e-6)
    assert fit.converged


@pytest.mark.parametrize("kind", KINDS)
def test_fit_bones_finds_the_bones_that_made_the_data(kind: str) -> None:
    truth = rig(kind)
    # a vertex moves with its main bone alone, so that every bone is determined
    indices, weights = truth.indices[:, :1], np.ones((len(truth.rest), 1))
    frames = motions.blend(truth.rest, indices, weights, truth.transforms)
    model = motions.model(truth.rest, indices, weights)
    fit = ssdr.fit_bones(frames, model, bone_model=kind, tolerance=1e-9)
    assert fit.skinning.bone_model == kind
    np.testing.assert_allclose(fit.skinning.transforms, truth.transforms, atol=1e-5)
    assert fit.rmse < 1e-6


@settings(max_examples=15)
@given(seed=st.integers(0, 10**6), noise=st.sampled_from([0.0, 0.05, 1.0]))
def test_warm_started_from_the_smaller_model_is_never_worse(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    rest = rng.standard_normal((30, 3))
    indices, weights = motions.weights_of(rng, 30, 3, 3)
    frames = motions.blend(rest, indices, weights, motions.motions(rng, 5, 3))
    frames += noise * rng.standard_normal(frames.shape)
    model, last = motions.model(rest, indices, weights, bones=3), np.inf
    for kind in MODELS:
        warm = model.n_frames > 1
        fit = ssdr.fit_bones(frames, model, bone_model=kind, from_transforms=warm)
        check_kind(fit.skinning.transforms, kind)
        assert fit.rmse <= last * (1 + 1e-9) + 1e-7
        model, last = fit.skinning, fit.rmse
