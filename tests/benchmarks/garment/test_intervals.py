"""Intervals over clips, against cases with known answers."""

import math

import numpy as np
import pytest

from benchmarks.garment.intervals import intervals, paired_ratio
from garmentnet.evaluation.scores import Parts, Score, Scores


def clips(rng, n, *, hardness=0.5, scatter=0.05):
    """Errors of two methods on clips that are hard or easy for both; the first is 10% better."""
    b = np.exp(hardness * rng.normal(size=n))
    return 0.9 * b * np.exp(scatter * rng.normal(size=n)), b


def test_scaled_errors_have_an_exact_ratio():
    b = np.array([12.0, 40.0, 25.0, 31.0])
    r = paired_ratio(0.8 * b, b, frames=[300, 100, 200, 300])
    assert np.allclose(r, 0.8, rtol=1e-12)


def test_pooling_weighs_frames():
    a, b, f = np.array([3.0, 1.0]), np.array([2.0, 4.0]), np.array([100, 300])
    expected = math.sqrt((f @ a**2) / (f @ b**2))
    assert math.isclose(paired_ratio(a, b, frames=f)[0], expected)
    assert math.isclose(paired_ratio(a, np.ones(len(a)), frames=f)[0], math.sqrt(f @ a**2 / 400))
    assert paired_ratio([2.0], [4.0]) == (0.5, None, None)  # of one clip, no interval
    assert paired_ratio(a, b, rng=3) == paired_ratio(a, b, rng=np.random.default_rng(3))


@pytest.mark.parametrize("n", [6, 24])
def test_the_interval_holds_the_true_ratio(n):
    rng = np.random.default_rng(5)
    a, b = clips(rng, 1_000_000, scatter=0.1)
    true = math.sqrt((a**2).sum() / (b**2).sum())
    repeats, held = 400, 0
    for k in range(repeats):
        _, low, high = paired_ratio(*clips(rng, n, scatter=0.1), resamples=500, rng=k)
        held += low <= true <= high
    # Plain percentiles hold it in 82% (6 clips); the standard error of the count is 1.1%.
    assert 0.89 <= held / repeats <= 0.98


def test_pairing_narrows_the_interval():
    rng = np.random.default_rng(2)
    a, b = clips(rng, 24)
    paired, apart = paired_ratio(a, b), paired_ratio(rng.permutation(a), b)
    assert math.isclose(paired[0], apart[0])
    assert np.diff(paired[1:]) < 0.2 * np.diff(apart[1:])


def scores(name, errors, frames=100):
    """A method's scores of clips with given RMSE, all other figures twice the RMSE."""

    def one(label, clips, rmse):
        part = Score(rmse, 2 * rmse, 2 * rmse)
        parts = Parts(part, part, part, 1.0)
        return Scores(label, frames, parts, parts, {}, {}, clips)

    clips = tuple(one(f"clip-{k}", (), e) for k, e in enumerate(errors))
    return one(name, clips, float(np.sqrt(np.mean(np.square(errors)))))


def test_the_same_method_twice_has_the_ratio_1_on_every_draw():
    errors = [20.0, 30.0, 25.0]
    found = intervals([scores("a", errors), scores("b", errors)], "a")
    none = intervals([scores("a", errors[:2]), scores("exact", [0.0, 0.0])], "exact")
    assert none["a"]["high"] == [None, None, None]
    assert found["b"]["low"] == [1.0, 1.0, 1.0]
