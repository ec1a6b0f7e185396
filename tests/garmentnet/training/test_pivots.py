import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.garment.rules import inverse_distance, nearest
from garmentnet.paper.ensemble import (
    convex_fit,
    extremes,
    fit_kernel,
    gram,
    left_out,
    select_pivots,
)
from ssdr.common.errors import InputError


def error_of(mixed, rule):
    """RMSE of the weights that a rule gives the pivots of a mixture."""
    pivots, theta, q = mixed
    w = rule(pivots, theta)
    return np.sqrt(max(w @ q @ w, 0.0))


def test_gram_is_the_error_of_a_mixture():
    rng = np.random.default_rng(0)
    truth = rng.normal(size=(4, 7, 3))
    answers = [truth + rng.normal(size=truth.shape) for _ in range(3)]
    w = np.array([0.2, 0.5, 0.3])
    mixed = sum(a * g for a, g in zip(w, answers, strict=True))
    expected = np.sqrt(((mixed - truth) ** 2).sum(-1).mean())
    assert np.isclose(np.sqrt(w @ gram(answers, truth) @ w), expected)


@settings(max_examples=25)
@given(st.integers(0, 10**6))
def test_convex_fit_beats_a_grid(seed):
    rng = np.random.default_rng(seed)
    r = rng.normal(size=(3, 8)) + rng.normal(size=8)
    q = r @ r.T
    w, error = convex_fit(q)
    assert w.min() >= 0
    assert np.isclose(w.sum(), 1)
    a, b = np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41))
    grid = np.stack([a.ravel(), b.ravel(), 1 - a.ravel() - b.ravel()], axis=1)
    grid = grid[grid[:, 2] >= -1e-12]
    best = np.sqrt(np.einsum("ni,ij,nj->n", grid, q, grid).clip(0).min())
    assert error <= best + 1e-9


def line(n=6, noise=0.0, seed=0):
    """Sets along one parameter that matters and one that does not; linear answers."""
    rng = np.random.default_rng(seed)
    theta = np.stack([np.linspace(-1, 1, n), rng.uniform(-1, 1, n)], axis=1)
    shape = rng.normal(size=(2, 5, 3))
    truths = [t[0] * shape for t in theta]
    nets = [t + noise * rng.normal(size=shape.shape) for t in truths]
    return theta, nets, truths, [gram(nets, t) for t in truths], shape


def test_extremes_and_pivots():
    theta, _, _, grams, _ = line()
    assert {0, 5} <= set(extremes(theta, 6))
    assert extremes(np.zeros((4, 3)), 1) == [0]
    own = theta.copy()
    own[:, 1] = 0  # one parameter: both ends, and every other set lies between
    assert extremes(own, 2) == [0, 5]
    assert select_pivots(grams, own, 2) == [0, 5]
    six = select_pivots(grams, own, 6)
    assert sorted(six) == [0, 1, 2, 3, 4, 5]
    for count in (1, 7):
        with pytest.raises(InputError, match="2 or more, the sets with an extreme, and at most 6"):
            select_pivots(grams, own, count)


def test_worst_fitted_set_is_next():
    rng = np.random.default_rng(0)
    theta = np.array([[-1.0], [0.2], [0.4], [1.0]])
    shape, odd = rng.normal(size=(2, 4, 3)), rng.normal(size=(2, 4, 3))
    nets = [-shape, 0.2 * shape, 0.4 * shape + odd, shape]  # the third leaves the line
    grams = [gram(nets, n) for n in nets]
    assert select_pivots(grams, theta, 3) == [0, 3, 2]


def test_alternatives():
    pivots = np.array([[0.0], [1.0], [3.0]])
    assert np.allclose(inverse_distance(pivots, [1.0]), [0, 1, 0])
    w = inverse_distance(pivots, [2.0])
    assert np.allclose(w, np.array([0.5, 1, 1]) / 2.5)
    assert np.allclose(nearest(pivots, [1.9]), [0, 1, 0])


def test_g_learns_which_parameter_matters():
    theta, _, truths, grams, shape = line(n=8)
    sets = left_out(grams, theta, range(8))
    kernel = fit_kernel(sets, steps=400)
    learned = [error_of(m, kernel.weights) for m in sets]
    plain = [error_of(m, inverse_distance) for m in sets]
    pivots, own, q = sets[2]
    assert np.array_equal(q, np.delete(np.delete(grams[2], 2, 0), 2, 1))
    assert np.array_equal(pivots, np.delete(theta, 2, 0))
    assert np.array_equal(own, theta[2])
    # The ends cannot be reached from inside by any convex mixture; the rest can.
    assert np.mean(learned[1:-1]) < 0.6 * np.mean(plain[1:-1])
    place = np.array([0.1, -0.9])
    w = kernel.weights(theta, place)
    gap = sum(a * t for a, t in zip(w, truths, strict=True)) - 0.1 * shape
    other = inverse_distance(theta, place) @ theta[:, 0] - 0.1
    assert np.abs(gap).max() < max(0.1, abs(other)) * np.abs(shape).max()


def test_fit_does_not_disturb_other_randomness():
    theta, _, _, grams, _ = line()
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    fit_kernel(left_out(grams, theta, range(6)), steps=1)
    assert torch.equal(torch.rand(3), expected)
