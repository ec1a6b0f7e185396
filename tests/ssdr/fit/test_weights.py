"""Weights against brute force over all supports, a general optimiser and the definitions."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

import ssdr
from helpers import motions, naive
from ssdr.fit.weights import WeightFit


def check_simplex(fit: WeightFit, n_bones: int, influences: int) -> None:
    assert fit.indices.shape == fit.weights.shape
    assert fit.weights.shape[1] == influences
    assert fit.weights.min() >= 0
    assert np.abs(fit.weights.sum(axis=1) - 1).max() < 1e-12
    assert (np.diff(fit.weights, axis=1) <= 0).all()
    assert fit.indices.min() >= 0
    assert fit.indices.max() < n_bones
    assert (fit.indices[fit.weights == 0] == 0).all()
    for indices, weights in zip(fit.indices, fit.weights, strict=True):
        used = indices[weights > 0]
        assert len(set(used)) == len(used)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    bones=st.integers(1, 5),
    influences=st.integers(1, 6),
    noise=st.sampled_from([0.0, 0.05, 1.0]),
)
def test_against_every_support(seed: int, bones: int, influences: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    n = 9
    rest = rng.standard_normal((n, 3))
    transforms = motions.motions(rng, 4, bones)
    indices, weights = motions.weights_of(rng, n, bones, influences)
    frames = motions.blend(rest, indices, weights, transforms)
    frames += noise * rng.standard_normal(frames.shape)
    fit = ssdr.fit_weights(frames, rest=rest, transforms=transforms, influences=influences)
    check_simplex(fit, bones, influences)
    images = naive.bone_images(rest, transforms)
    targets = frames.transpose(1, 0, 2).reshape(n, -1)
    size = float((frames**2).sum()) / n
    best = np.array([naive.best_convex(images[i], targets[i], influences)[0] for i in range(n)])
    assert (fit.squared_error >= best - 1e-12 * size).all()
    if influences >= bones or noise == 0:
        # a convex problem, or one whose convex optimum has few enough influences
        assert (fit.squared_error <= best * (1 + 1e-5) + 1e-10 * size).all()
    else:
        single = ((images - targets[..., None]) ** 2).sum(axis=1).min(axis=1)
        assert (fit.squared_error <= single + 1e-10 * size).all()


def test_many_bones_against_slsqp(rng: np.random.Generator) -> None:
    n, bones = 5, 9
    rest = rng.standard_normal((n, 3))
    transforms = motions.motions(rng, 6, bones, shift=0.3)
    frames = rest + 0.3 * rng.standard_normal((6, n, 3))
    fit = ssdr.fit_weights(frames, rest=rest, transforms=transforms, influences=bones)
    images = naive.bone_images(rest, transforms)
    targets = frames.transpose(1, 0, 2).reshape(n, -1)
    for i in range(n):
        a, b = images[i], targets[i]
        found = minimize(
            lambda w, a=a, b=b: ((a @ w - b) ** 2).sum(),
            np.full(bones, 1 / bones),
            jac=lambda w, a=a, b=b: 2 * a.T @ (a @ w - b),
            bounds=[(0, 1)] * bones,
            constraints={"type": "eq", "fun": lambda w: w.sum() - 1, "jac": np.ones_like},
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert fit.squared_error[i] == pytest.approx(found.fun, rel=1e-5)
        dense = np.zeros(bones)
        np.add.at(dense, fit.indices[i], fit.weights[i])
        np.testing.assert_allclose(dense, found.x, atol=2e-3)


def test_sparse_choice_is_near_the_best_support() -> None:
    """Which K bones is a hard choice: on average within a thousandth of the best of all."""
    rng = np.random.default_rng(7)
    n, bones, k = 40, 6, 2
    rest = rng.standard_normal((n, 3))
    transforms = motions.motions(rng, 8, bones, shift=0.3)
    indices, weights = motions.weights_of(rng, n, bones, 4)
    frames = motions.blend(rest, indices, weights, transforms)
    fit = ssdr.fit_weights(frames, rest=rest, transforms=transforms, influences=k)
    images = naive.bone_images(rest, transforms)
    targets = frames.transpose(1, 0, 2).reshape(n, -1)
    best = sum(naive.best_convex(images[i], targets[i], k)[0] for i in range(n))
    assert best * (1 - 1e-9) <= fit.squared_error.sum() <= 1.001 * best


def test_error_is_that_of_skinning(rng: np.random.Generator) -> None:
    rest = rng.standard_normal((7, 3))
    transforms = motions.motions(rng, 5, 4)
    frames = 30 + rest + 0.5 * rng.standard_normal((5, 7, 3))
    fit = ssdr.fit_weights(frames, rest=rest, transforms=transforms, influences=3)
    expected = naive.squared_error(frames, rest, fit.indices, fit.weights, transforms)
    np.testing.assert_allclose(fit.squared_error, expected, rtol=1e-8)
    assert fit.rmse == pytest.approx(np.sqrt(expected.sum() / 35), rel=1e-8)


@pytest.mark.parametrize("influences", [13, 20])
def test_more_influences_than_slots_of_the_warm_support(influences: int) -> None:
    rng = np.random.default_rng(3)
    bones, n = 20, 6
    rest = rng.standard_normal((n, 3))
    transforms = motions.motions(rng, 30, bones)
    frames = motions.blend(
        rest,
        np.tile(np.arange(influences, dtype=np.int32), (n, 1)),
        np.full((n, influences), 1 / influences),
        transforms,
    )
    fit = ssdr.fit_weights(frames, rest=rest, transforms=transforms, influences=influences)
    check_simplex(fit, bones, influences)
    assert fit.rmse < 1e-6
    np.testing.assert_allclose(fit.weights[:, :influences], 1 / influences, atol=1e-5)


def test_bones_that_move_alike() -> None:
    """Twins make the Hessian singular; the error must not suffer."""
    rng = np.random.default_rng(5)
    rest = rng.standard_normal((12, 3))
    own = motions.motions(rng, 6, 3)
    indices, weights = motions.weights_of(rng, 12, 3, 3)
    frames = motions.blend(rest, indices, weights, own)
    fit = ssdr.fit_weights(
        frames, rest=rest, transforms=np.concatenate([own, own, own], axis=1), influences=4
    )
    check_simplex(fit, 9, 4)
    assert fit.rmse < 1e-6


def test_smoothness_lowers_the_dirichlet_energy() -> None:
    rig = motions.chain(bones=4, rows=12)
    frames = motions.wobble(rig, 0.05)
    energy, error = [], []
    for length in (0.0, 0.02, 0.2, 20.0):
        fit = ssdr.fit_weights(
            frames,
            rig.faces,
            rest=rig.rest,
            transforms=rig.transforms,
            smoothness=length,
            iterations=300,
        )
        check_simplex(fit, 4, 4)
        energy.append(naive.dirichlet(rig.faces, fit.indices, fit.weights, 4))
        error.append(fit.rmse)
    assert energy == sorted(energy, reverse=True)
    assert energy[-1] < 0.01 * energy[0]
    assert error == sorted(error)


def test_smoothness_descends_the_penalised_error() -> None:
    """Where no weight is cut (K = B) every sweep lowers error + F l^2 sum |jump|^2."""
    rig = motions.chain(bones=4, rows=12)
    frames, length = motions.wobble(rig, 0.05), 0.3
    values = []
    for sweeps in (1, 2, 3, 5, 9, 40):
        fit = ssdr.fit_weights(
            frames,
            rig.faces,
            rest=rig.rest,
            transforms=rig.transforms,
            smoothness=length,
            iterations=sweeps,
        )
        error = naive.squared_error(frames, rig.rest, fit.indices, fit.weights, rig.transforms)
        energy = naive.dirichlet(rig.faces, fit.indices, fit.weights, 4)
        values.append(error.sum() + len(frames) * length**2 * energy)
    assert (np.diff(values) < 0).all()
    assert values[0] > 1.01 * values[-1]


@dataclasses.dataclass(frozen=True)
class Refusal:
    argument: str
    change: dict[str, object]


@pytest.mark.parametrize(
    "case",
    [
        Refusal("influences", {"influences": 0}),
        Refusal("influences", {"influences": 2.5}),
        Refusal("rest", {"rest": np.zeros((3, 3))}),
        Refusal("transforms", {"transforms": np.zeros((20, 4, 3, 4))}),
        Refusal("transforms", {"transforms": np.tile(np.eye(4)[:3], (19, 2, 1, 1))}),
        Refusal("iterations", {"iterations": 0}),
        Refusal("smoothness", {"smoothness": -1.0}),
        Refusal("smoothness", {"smoothness": float("nan")}),
    ],
    ids=str,
)
def test_refuses(case: Refusal) -> None:
    rig = motions.chain(bones=4, rows=5)
    given_ = {"rest": rig.rest, "transforms": rig.transforms} | case.change
    with pytest.raises(ssdr.InputError) as caught:
        ssdr.fit_weights(rig.frames, rig.faces, **given_)
    assert caught.value.argument == case.argument


def test_refuses_a_reflection() -> None:
    rig = motions.chain(bones=2, rows=5)
    mirrored = rig.transforms * np.array([1, 1, -1, 1.0])
    with pytest.raises(ssdr.InputError, match="rigid"):
        ssdr.fit_weights(rig.frames, rest=rig.rest, transforms=mirrored)
