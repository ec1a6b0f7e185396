"""The kernel of the polish."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ssdr.kernels.polish import invert


def test_the_inverse_of_what_depends_on_itself_does_not_overflow() -> None:
    """Weights that say the same, to rounding: what is undetermined stays where it is."""
    numba = pytest.importorskip("numba")

    @numba.njit
    def inverse(a: Any, scale: Any, out: Any) -> None:
        invert(a, len(a), scale, out)

    rng = np.random.default_rng(0)
    for n in (2, 4, 6, 8):
        root = rng.standard_normal((n, n))
        good = root @ root.T + np.eye(n)
        good /= np.sqrt(np.outer(np.diag(good), np.diag(good)))
        scale, out = rng.uniform(0.1, 10, n), np.zeros((n, n))
        inverse(good.copy(), scale, out)
        np.testing.assert_allclose(out, np.linalg.inv(good) * np.outer(scale, scale), rtol=1e-5)
        # a unit diagonal, and beside it rounding that was scaled up with it
        bad = np.eye(n) + np.tril(rng.uniform(-2, 2, (n, n)), -1)
        inverse(bad, np.ones(n), out)
        assert np.isfinite(out).all()
        assert np.abs(out).max() < 1e13
