"""What the benchmarks compute themselves: errors, sizes, times; how records become tables."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ssdr
from benchmarks import bench, common
from benchmarks.peers import charts, model_size, tables

ROOT = Path(__file__).resolve().parents[2]


def _model(seed: int = 0) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    n, f, b, k = 30, 70, 6, 3
    rest = rng.standard_normal((n, 3))
    indices = np.argsort(rng.random((n, b)), axis=1)[:, :k]
    weights = rng.dirichlet(np.ones(k), n)
    return rest, indices, weights, rng.standard_normal((f, b, 3, 4))


def test_the_error_is_the_same_by_two_ways_of_skinning() -> None:
    rest, indices, weights, transforms = _model()
    skinned = common.reskin(rest, indices, weights, transforms)
    frames = skinned + 0.1 * np.random.default_rng(1).standard_normal(skinned.shape)
    fast = model_size.skinned_e(frames, rest, model_size.dense(indices, weights, 6), transforms)
    assert fast == pytest.approx(common.error_e(frames, skinned), rel=1e-12)


@pytest.mark.parametrize("bits", [8, 16])
def test_stored_weights_are_whole_steps_that_sum_to_one(bits: int) -> None:
    weights = _model()[2]
    weights[0] = (1.0, 0.0, 0.0)
    out = model_size.stored_weights(weights, bits)
    top = 2**bits - 1
    np.testing.assert_allclose(out * top, np.rint(out * top), atol=1e-9)
    np.testing.assert_array_equal(np.rint(out * top).sum(axis=1), top)
    assert abs(out - weights).max() <= 1 / top
    assert (out >= 0).all()
    np.testing.assert_array_equal(out[0], weights[0])


def test_bytes_by_hand_and_by_the_package() -> None:
    # 10 + 5 positions, 10 counts, 37 pairs of two bytes, 3 x 5 keys of seven float32
    assert model_size.model_bytes(10, 3, 5, 37, 8) == 180 + 10 + 74 + 420
    assert model_size.model_bytes(10, 3, 300, 37, 8, "affine") == 12 * 310 + 10 + 111 + 48 * 900
    rest, indices, weights, transforms = _model()
    transforms[..., :3] = np.eye(3)
    model = ssdr.Skinning(rest, indices, weights, transforms)
    assert model_size.model_bytes(30, 70, 6, 90, 16) == ssdr.parsimony.size(model).total


def test_pca_is_the_best_linear_model() -> None:
    rng = np.random.default_rng(2)
    for n, f in ((50, 8), (12, 30)):
        low = rng.standard_normal((n, 4)) @ rng.standard_normal((4, 3 * f))
        x = low + 0.01 * rng.standard_normal(low.shape)
        frames = x.reshape(n, f, 3).transpose(1, 0, 2)
        values = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)
        for rank, size_, e in model_size.pca_curve(frames):
            left = 1000 * np.sqrt((values[rank:] ** 2).sum() / x.size)
            # the coefficients are rounded to 16 bits
            assert e == pytest.approx(left, rel=0.02, abs=0.1)
            assert size_ == 12 * f + rank * (2 * n + 12 * f)


def _rows(*runs: tuple[str, list[list[float]]]) -> dict[str, dict[str, Any]]:
    jobs = [(bench.job(solver, "ea_bone", 10), curve) for solver, curve in runs]
    shared = {"normals": 1.0, "cpu": 9.0}
    return {
        bench.key_of(job): {**job, **shared, "curve": curve, "E": curve[-1][3]}
        for job, curve in jobs
    }


def test_times_are_to_within_a_percent_of_dem_bones_best() -> None:
    slow = "dembones default", [[0, 1.0, 0.9, 9.0], [1, 2.0, 1.8, 6.0]]
    best = "dembones 0", [[0, 1.0, 0.9, 8.0], [1, 10.0, 8.0, 4.03], [2, 20.0, 16.0, 4.0]]
    ours = "ssdr balanced", [[5, 0.5, 0.4, 4.05], [6, 0.8, 0.5, 4.04], [7, 0.9, 0.6, 2.0]]
    (row,) = tables.race_rows(_rows(slow, best, ours))
    assert row["peer"]["solver"] == "dembones 0"
    assert row["peer seconds"] == 8.0
    assert row["seconds"] == {"balanced": 0.5}
    assert row["sooner"] == pytest.approx(16.0)
    assert row["ratio"] == {"balanced": 0.5}
    figures = tables.figures(_rows(slow, best, ours))
    assert figures["balanced median"] == "50 %"
    assert figures["sooner least"] == "16"
    assert "sooner" not in tables.race_rows(_rows(ours))[0]


def test_front() -> None:
    assert charts.front_of([(3, 1), (1, 5), (2, 6), (4, 1)]) == [(1, 5), (3, 1)]


@pytest.mark.slow
def test_a_solver_runs_in_a_process_of_its_own_and_tells_the_truth() -> None:
    job: dict[str, Any] = bench.job("ssdr fast", "tube:200:12", 4, 2)
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "peers" / "solvers.py"),
         json.dumps({**job, "slice": 0.0, "core": None})],
        input="go\n" * 1000,
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    # with slices of no length it asks for its turn before every step
    assert done.stdout.split().count("ready") > 3
    row = json.loads(done.stdout.splitlines()[-1])
    assert row["defects"] == []
    assert row["E"] == pytest.approx(row["stated E"], rel=1e-9)
    errors = [point[3] for point in row["curve"]]
    assert errors == sorted(errors, reverse=True)
    assert all(a[1] <= b[1] for a, b in zip(row["curve"], row["curve"][1:], strict=False))
    assert row["curve"][-1][1] <= row["wall"]


@pytest.mark.slow
def test_solvers_take_turns_and_a_crash_is_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "SLICE", 0.05)
    good = bench.job("ssdr fast", "tube:200:12", 4)
    bad = bench.job("ssdr fast", "tube:200:12", -1)
    own = bench.job(str(ROOT / "benchmarks/leaderboard/example_solver.py"), "tube:200:12", 3)
    old = bench.job("2012", "tube:200:12", 5)
    rows = {r["bones"]: r for r in bench.take_turns([good, bad, own, old])}
    assert rows[4]["E"] > 0
    assert rows[3]["defects"] == []
    assert rows[3]["curve"] == [[1, *rows[3]["curve"][0][1:3], pytest.approx(rows[3]["E"])]]
    # the method's own account beside its model, skinned again
    assert rows[5]["curve"][-1][3] == pytest.approx(rows[5]["E"], rel=1e-5)
    assert "failed" in rows[-1]
    assert "bones: expected" in rows[-1]["said"][0]
