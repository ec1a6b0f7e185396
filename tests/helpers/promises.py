"""What holds for every decomposition."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.measures import diagonal, rmse_of


def check(
    result: ssdr.Decomposition, array: np.ndarray, bones: int, influences: int = 4
) -> ssdr.Decomposition:
    """What holds for every result."""
    s = result.skinning
    n_frames, n = array.shape[:2]
    assert s.transforms.shape == (n_frames, bones, 3, 4)
    assert s.rest.shape == (n, 3)
    assert s.indices.shape == s.weights.shape == (n, influences)
    assert s.indices.min() >= 0
    assert s.indices.max() < bones
    assert s.weights.min() >= 0
    assert np.abs(s.weights.sum(axis=1) - 1).max() < 1e-6
    assert (np.diff(s.weights, axis=1) <= 1e-12).all()
    assert (s.indices[s.weights == 0] == 0).all()
    r = s.transforms[..., :3]
    assert np.abs(np.einsum("tjca,tjcb->tjab", r, r) - np.eye(3)).max() < 1e-6
    assert np.abs(np.linalg.det(r) - 1).max() < 1e-6
    scale = max(diagonal(array), float(np.abs(array).max()))
    assert result.rmse == pytest.approx(rmse_of(s, array), rel=1e-6, abs=1e-13 * scale)
    errors = [record.rmse for record in result.history]
    assert (np.diff(errors) <= 0).all()
    assert errors[-1] == result.rmse
    assert (np.diff([record.elapsed for record in result.history]) >= 0).all()
    assert (np.diff([record.iteration for record in result.history]) >= 0).all()
    assert result.history[0].elapsed > 0
    assert result.stop_reason in (
        "converged",
        "plan finished",
        "iterations",
        "time limit",
        "cancelled",
    )
    assert result.converged == (result.stop_reason == "converged")
    return result
