"""Mixtures of simulations: a set among the pivots is met exactly, and the fit beats every rule."""

import numpy as np
import pytest

pytest.importorskip("torch")

from benchmarks.garment import mixing
from benchmarks.garment.mixing import Clips, apart, mixed


@pytest.fixture
def run(toy_store, toy_network, monkeypatch):
    monkeypatch.setattr(mixing, "COUNTS", (4, 5))
    return Clips(toy_store, toy_network, 3)


def test_perfect_pivots(run):
    rows = mixed(run, run.simulated)
    best = rows["best convex weights"]
    assert set(best) == {f"{m}, {k}" for m in ("seen", "unseen") for k in (4, 5)}
    for row in rows.values():
        assert all(best[key] <= row[key] + 1e-6 for key in best)
    # A training set in place of the test set is one of its own pivots.
    run.test = run.train[:1]
    rows = mixed(run, run.simulated)
    for name in ("nearest", "inverse distance", "best convex weights"):
        assert rows[name]["unseen, 5"] < 1e-3
    assert rows["kernel exp(−d), the published code"]["unseen, 5"] > 0.01


def test_sets_that_differ_in_one_parameter_are_apart_by_it(run, monkeypatch):
    rng = np.random.default_rng(0)
    shape, ways = rng.normal(size=(5, 9, 3)), np.eye(3)

    def simulated(motion, parameters):
        return shape + 0.02 * parameters.normalised() @ ways

    monkeypatch.setattr(run, "simulated", simulated)
    found = apart(run)
    assert found["bending"] == pytest.approx(20, rel=1e-6)
    assert found["time scale"] == pytest.approx(20, rel=1e-6)
