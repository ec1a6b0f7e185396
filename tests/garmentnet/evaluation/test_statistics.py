"""Intervals over clips and learning curves, against cases with known answers."""

import dataclasses
import math

import numpy as np
import pytest

from garmentnet.evaluation.statistics import (
    fit_power_law,
    paired_ratio,
    pooled_error,
)
from ssdr.errors import InputError


def clips(rng, n, *, hardness=0.5, scatter=0.05):
    """Errors of two methods on clips that are hard or easy for both; the first is 10% better."""
    b = np.exp(hardness * rng.normal(size=n))
    return 0.9 * b * np.exp(scatter * rng.normal(size=n)), b


@pytest.mark.parametrize("power", [1.0, 2.0])
def test_scaled_errors_have_an_exact_ratio(power):
    b = np.array([12.0, 40.0, 25.0, 31.0])
    r = paired_ratio(0.8 * b, b, frames=[300, 100, 200, 300], power=power)
    assert np.allclose([r.ratio, r.low, r.high], 0.8, rtol=1e-12)
    assert r.n_clips == 4


def test_pooling_weighs_frames():
    a, b, f = np.array([3.0, 1.0]), np.array([2.0, 4.0]), np.array([100, 300])
    expected = math.sqrt((f @ a**2) / (f @ b**2))
    assert math.isclose(paired_ratio(a, b, frames=f).ratio, expected)
    assert math.isclose(pooled_error(a, frames=f).value, math.sqrt(f @ a**2 / 400))
    assert math.isclose(pooled_error(a, frames=f, power=1).value, 1.5)


def test_equal_seeds_give_equal_intervals():
    a, b = clips(np.random.default_rng(0), 24)
    first = paired_ratio(a, b, rng=3)
    assert first == paired_ratio(a, b, rng=3)
    assert first == paired_ratio(a, b, rng=np.random.default_rng(3))
    assert first != paired_ratio(a, b, rng=4)
    assert first.low < first.ratio < first.high


@pytest.mark.parametrize("n", [6, 24])
def test_the_interval_holds_the_true_ratio(n):
    rng = np.random.default_rng(5)
    a, b = clips(rng, 1_000_000, scatter=0.1)
    true = math.sqrt((a**2).sum() / (b**2).sum())
    repeats, held = 400, 0
    for k in range(repeats):
        r = paired_ratio(*clips(rng, n, scatter=0.1), resamples=500, rng=k)
        held += r.low <= true <= r.high
    # Plain percentiles hold it in 82% (6 clips); the standard error of the count is 1.1%.
    assert 0.89 <= held / repeats <= 0.98


def test_pairing_narrows_the_interval():
    rng = np.random.default_rng(2)
    a, b = clips(rng, 24)
    paired, apart = paired_ratio(a, b), paired_ratio(rng.permutation(a), b)
    assert math.isclose(paired.ratio, apart.ratio)
    assert paired.high - paired.low < 0.2 * (apart.high - apart.low)


def test_the_interval_of_an_error_is_that_of_a_mean():
    x = np.random.default_rng(1).normal(10, 1, size=200)
    e = pooled_error(x, power=1)
    assert math.isclose(e.value, x.mean())
    half = 1.972 * x.std(ddof=1) / math.sqrt(200)
    assert np.allclose([e.low, e.high], [x.mean() - half, x.mean() + half], atol=0.1 * half)


def test_one_clip_has_no_interval():
    r = paired_ratio([2.0], [4.0])
    assert r.ratio == 0.5
    assert math.isnan(r.low)
    assert math.isnan(r.high)


@pytest.mark.parametrize(
    ("a", "b", "options", "words"),
    [
        ([1, 2], [1], {}, "b: expected 2"),
        ([1, 2], [1, 0], {}, "b: expected positive"),
        ([1, -2], [1, 1], {}, "a: expected"),
        ([1, np.nan], [1, 1], {}, "a: expected"),
        ([], [], {}, "a: expected"),
        ([1, 2], [1, 1], {"frames": [1]}, "frames"),
        ([1, 2], [1, 1], {"frames": [1, 0]}, "frames"),
        ([1, 2], [1, 1], {"level": 95}, "level"),
        ([1, 2], [1, 1], {"resamples": 0}, "resamples"),
    ],
)
def test_refused_figures(a, b, options, words):
    with pytest.raises(InputError, match=words):
        paired_ratio(a, b, **options)


FRAMES = np.array([1000, 2000, 4000, 8000, 16000, 32000, 64000])


def test_a_power_law_is_found_again():
    law = fit_power_law(FRAMES, 600 * FRAMES**-0.35)
    assert np.allclose([law.exponent, law.coefficient], [0.35, 600])
    assert np.allclose([law.low, law.high], 0.35)
    assert law.floor is None
    assert np.allclose(law.error([1000, 64000]), 600 * FRAMES[[0, -1]] ** -0.35)


@pytest.mark.parametrize("floor", [6.0, "fit"])
def test_a_power_law_above_a_floor(floor):
    errors = np.hypot(6.0, 600 * FRAMES**-0.4)
    law = fit_power_law(FRAMES, errors, floor=floor)
    assert np.allclose([law.exponent, law.coefficient, law.floor], [0.4, 600, 6], rtol=1e-4)
    assert np.allclose(law.error(FRAMES), errors, rtol=1e-6)
    # Without the floor the curve looks flatter than it is.
    assert fit_power_law(FRAMES, errors).exponent < 0.4


def test_the_interval_of_the_exponent():
    rng, held = np.random.default_rng(0), 0
    for _ in range(200):
        law = fit_power_law(FRAMES, 600 * FRAMES**-0.35 * np.exp(0.03 * rng.normal(size=7)))
        held += law.low <= 0.35 <= law.high
    assert 0.9 <= held / 200 <= 1.0


def test_two_points_have_no_interval():
    law = fit_power_law([1000, 4000], [60, 30])
    assert math.isclose(law.exponent, 0.5)
    assert math.isnan(law.low)
    assert set(dataclasses.asdict(law)) >= {"exponent", "coefficient", "floor", "low", "high"}


@pytest.mark.parametrize(
    ("frames", "errors", "floor", "words"),
    [
        ([1000, 1000], [60, 30], None, "at least 2 different"),
        ([1000, 2000, 4000], [60, 40, 30], "fit", "at least 4 different"),
        ([1000, 2000], [60, 0], None, "errors"),
        ([1000, 2000], [60], None, "errors"),
        ([1000, 2000], [60, 40], 40.0, "floor: expected .*below every error"),
    ],
)
def test_refused_curves(frames, errors, floor, words):
    with pytest.raises(InputError, match=words):
        fit_power_law(frames, errors, floor=floor)
