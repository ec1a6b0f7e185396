"""The error over all frames."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import motions, naive
from ssdr.model.frame_error import largest_error, squared_error


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_true_error_against_loops(kind: type, rng: np.random.Generator) -> None:
    rig = motions.chain(bones=3, rows=6, frames=7)
    frames = (rig.frames + 0.1 * rng.standard_normal(rig.frames.shape)).astype(kind)
    shots = [ssdr.MeshSequence(frames[:4]), ssdr.MeshSequence(frames[4:])]
    got = squared_error(shots, rig.rest, rig.indices, rig.weights, rig.transforms)
    want = naive.squared_error(frames, rig.rest, rig.indices, rig.weights, rig.transforms)
    np.testing.assert_allclose(got, want, rtol=1e-10)


def test_a_largest_error_that_is_no_number_is_seen() -> None:
    rig = motions.chain(bones=3, rows=6, frames=7)
    transforms = rig.transforms.copy()
    transforms[5, 1, 0, 0] = np.nan
    shots = [ssdr.MeshSequence(rig.frames)]
    assert np.isnan(largest_error(shots, rig.rest, rig.indices, rig.weights, transforms))
