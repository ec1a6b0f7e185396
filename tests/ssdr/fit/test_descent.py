"""`ssdr2012`: bones and weights in turns from a start, and the best model that they reach."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import motions


def _frames() -> np.ndarray:
    return motions.wobble(motions.chain(), 0.2)


def test_it_is_the_alternation_of_single_steps() -> None:
    """One iteration, from public steps: three sweeps of the bones, then the weights of all."""
    frames = _frames()
    start = ssdr.ssdr2012(frames, bones=6, iterations=0)
    same = ssdr.initialize(frames, bones=6, rest=frames[0])
    assert np.array_equal(start.skinning.weights, same.weights)
    swept = ssdr.fit_bones(frames, same, from_transforms=True, max_sweeps=3, tolerance=0.0).skinning
    one = ssdr.ssdr2012(frames, bones=6, iterations=1)
    np.testing.assert_allclose(one.skinning.transforms, swept.transforms, atol=1e-9)


def test_the_rest_pose_is_kept_and_the_error_is_that_of_the_model() -> None:
    frames = _frames()
    for rest in (None, frames[3]):
        fit = ssdr.ssdr2012(frames, bones=6, influences=3, rest=rest, iterations=20)
        model = fit.skinning
        np.testing.assert_allclose(model.rest, frames[0 if rest is None else 3], atol=1e-12)
        off = model.skin() - frames
        assert fit.rmse == pytest.approx(np.sqrt((off**2).sum() / off[..., 0].size), rel=1e-9)
        assert (model.n_bones, model.n_influences, model.bone_model) == (6, 3, "rigid")


def test_the_best_model_so_far_is_reported_and_returned() -> None:
    frames, seen = _frames(), []
    fit = ssdr.ssdr2012(frames, bones=6, iterations=30, callback=seen.append)
    errors = [p.rmse for p in seen]
    assert [p.iteration for p in seen] == [*range(31)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] == pytest.approx(fit.rmse, rel=1e-9)
    assert errors[-1] < 0.9 * errors[0]
    assert seen[-1].fraction == 1.0


def test_the_callback_ends_it() -> None:
    seen = []
    ssdr.ssdr2012(_frames(), bones=3, callback=lambda p: seen.append(p) or len(seen) == 4)
    assert len(seen) == 4
