"""Inverses of small matrices, and the weight that costs least."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ssdr.kernels.simplex_qp import cheapest_to_drop, invert


def test_the_inverse_of_what_depends_on_itself_does_not_overflow() -> None:
    """Weights that say the same, to rounding: what is undetermined stays where it is."""
    numba = pytest.importorskip("numba")

    @numba.njit
    def inverse(a: Any, n: Any, full: Any, row: Any) -> None:
        invert(a, n, full, row)

    rng = np.random.default_rng(0)
    for n in (2, 4, 6, 8, 17):
        root = rng.standard_normal((n, n))
        good = root @ root.T + np.eye(n)
        good /= np.sqrt(np.outer(np.diag(good), np.diag(good)))
        full, row = np.full((n + 1, 32), 7.0), np.full(32, 7.0)
        inverse(np.tril(good), n, full, row)
        np.testing.assert_allclose(full[:n, :n], np.linalg.inv(good), rtol=1e-5)
        # a unit diagonal, and beside it rounding that was scaled up with it
        bad = np.eye(n) + np.tril(rng.uniform(-2, 2, (n, n)), -1)
        inverse(bad, n, full, row)
        assert np.isfinite(full[:n, :n]).all()
        assert np.abs(full[:n, :n]).max() < 1e13


def test_the_bone_without_which_the_error_rises_least(rng: np.random.Generator) -> None:
    """Against each left out in turn and the others solved again, their sum held."""
    numba = pytest.importorskip("numba")

    @numba.njit
    def choose(h: Any, w: Any, n: Any, a: Any, full: Any, row: Any, scale: Any) -> Any:
        return cheapest_to_drop(h, w, n, a, full, row, scale)

    for n in (2, 3, 5, 9):
        for _ in range(20):
            half = rng.standard_normal((n, n + 2))
            h, f = half @ half.T, rng.standard_normal(n)

            def least(used: np.ndarray, h: np.ndarray = h, f: np.ndarray = f) -> tuple:
                m = len(used)
                k = np.ones((m + 1, m + 1))
                k[:m, :m], k[m, m] = h[np.ix_(used, used)], 0.0
                w = np.linalg.solve(k, np.append(f[used], 1.0))[:m]
                return w, w @ h[np.ix_(used, used)] @ w - 2 * f[used] @ w

            w, all_used = least(np.arange(n))
            losses = [least(np.delete(np.arange(n), q))[1] for q in range(n - 1)]
            scratch = np.empty((n, n)), np.empty((n, 16)), np.empty(16), np.empty(n)
            first, second, rise = choose(h, w, n, *scratch)
            order = np.argsort(losses)
            assert first == order[0]
            assert rise == pytest.approx(losses[first] - all_used, rel=1e-5)
            assert second == (order[1] if n > 2 else -1)
