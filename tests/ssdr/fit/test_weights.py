"""Weights against brute force over all supports, a general optimiser and the definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

import ssdr
from helpers import motions, naive


def solve(
    frames: np.ndarray, rest: np.ndarray, transforms: np.ndarray, influences: int
) -> ssdr.fit.fit.Fit:
    """Weights of these bones, checked."""
    model = motions.model(rest, transforms=transforms)
    return checked(ssdr.fit_weights(frames, model, influences=influences), influences)


def checked(fit: ssdr.fit.fit.Fit, influences: int) -> ssdr.fit.fit.Fit:
    s = fit.skinning
    assert s.weights.shape == s.indices.shape == (s.n_vertices, influences)
    assert s.weights.min() >= 0
    assert np.abs(s.weights.sum(axis=1) - 1).max() < 1e-12
    assert (np.diff(s.weights, axis=1) <= 0).all()
    assert s.indices.min() >= 0
    assert s.indices.max() < s.n_bones
    assert (s.indices[s.weights == 0] == 0).all()
    for indices, weights in zip(s.indices, s.weights, strict=True):
        used = indices[weights > 0]
        assert len(set(used)) == len(used)
    return fit


def images_and_targets(
    frames: np.ndarray, rest: np.ndarray, transforms: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where each bone alone puts each vertex, and where it should be."""
    targets = frames.transpose(1, 0, 2).reshape(len(rest), -1)
    return naive.bone_images(rest, transforms), targets


@settings(max_examples=25)
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
    fit = solve(frames, rest, transforms, influences)
    images, targets = images_and_targets(frames, rest, transforms)
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
    fit = solve(frames, rest, transforms, bones)
    images, targets = images_and_targets(frames, rest, transforms)
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
        np.add.at(dense, fit.skinning.indices[i], fit.skinning.weights[i])
        np.testing.assert_allclose(dense, found.x, atol=2e-3)


def test_sparse_choice_is_near_the_best_support() -> None:
    """Which K bones is a hard choice: on average within a thousandth of the best of all."""
    rng = np.random.default_rng(7)
    n, bones, k = 40, 6, 2
    rest = rng.standard_normal((n, 3))
    transforms = motions.motions(rng, 8, bones, shift=0.3)
    indices, weights = motions.weights_of(rng, n, bones, 4)
    frames = motions.blend(rest, indices, weights, transforms)
    fit = solve(frames, rest, transforms, k)
    images, targets = images_and_targets(frames, rest, transforms)
    best = sum(naive.best_convex(images[i], targets[i], k)[0] for i in range(n))
    assert best * (1 - 1e-9) <= fit.squared_error.sum() <= 1.001 * best


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
    fit = solve(frames, rest, transforms, influences)
    assert fit.rmse < 1e-6
    np.testing.assert_allclose(fit.skinning.weights[:, :influences], 1 / influences, atol=1e-5)


def test_bones_that_move_alike() -> None:
    """Twins make the Hessian singular; the error must not suffer."""
    rng = np.random.default_rng(5)
    rest = rng.standard_normal((12, 3))
    own = motions.motions(rng, 6, 3)
    indices, weights = motions.weights_of(rng, 12, 3, 3)
    frames = motions.blend(rest, indices, weights, own)
    fit = solve(frames, rest, np.concatenate([own, own, own], axis=1), 4)
    assert fit.rmse < 1e-6


def smoothed(length: float, iterations: int) -> tuple[float, float]:
    """Squared error and the weights' Dirichlet energy, of a chain of four bones."""
    chain = motions.chain(bones=4, rows=12)
    frames = motions.wobble(chain, 0.05)
    fit = ssdr.fit_weights(frames, chain.skinning, smoothness=length, iterations=iterations)
    s = checked(fit, 4).skinning
    error = naive.squared_error(frames, chain.rest, s.indices, s.weights, chain.transforms)
    np.testing.assert_allclose(fit.squared_error, error, rtol=1e-6)
    return error.sum(), naive.dirichlet(chain.faces, s.indices, s.weights, 4)


def test_smoothness_descends_the_penalised_error() -> None:
    """Where no weight is cut (K = B) every sweep lowers error + F l^2 sum |jump|^2."""
    found = [smoothed(0.3, sweeps) for sweeps in (1, 2, 3, 5, 9, 40)]
    values = [error + 20 * 0.3**2 * energy for error, energy in found]
    assert (np.diff(values) < 0).all()
    assert values[0] > 1.01 * values[-1]
