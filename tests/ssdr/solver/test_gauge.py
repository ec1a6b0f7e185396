"""Bones that stretch have a mean stretch of one."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import motions
from helpers.stretches import KINDS, check_kind, rig, stretched
from ssdr.solver.alternation import normalise_gauge
from ssdr.solver.model import FREE, Constraints, Model


@pytest.mark.parametrize("kind", KINDS)
def test_gauge_moves_nothing_and_makes_the_mean_stretch_one(kind: str) -> None:
    rng = np.random.default_rng(5)
    boxes = motions.boxes(2, points=20)
    m = stretched(boxes.transforms, kind)
    # two parts, each in a gauge of its own
    skew = (
        np.array([[3.0, 0, 0], [0, 2.0, 0.4], [0, 0, 0.5]]) if kind == "affine" else 3 * np.eye(3)
    )
    rest = boxes.rest.copy()
    rest[:20] = rest[:20] @ skew.T
    m[:, 0, :, :3] = m[:, 0, :, :3] @ np.linalg.inv(skew)
    model = Model.start(m.copy(), rest, boxes.indices[:, 0].astype(np.intp), 2)
    before = motions.blend(model.rest, model.indices, model.weights, model.transforms)
    importance = 0.5 + rng.random(40)
    normalise_gauge(model, importance, Constraints(bone_model=kind))  # type: ignore[arg-type]
    after = motions.blend(model.rest, model.indices, model.weights, model.transforms)
    np.testing.assert_allclose(after, before, atol=1e-9)
    linear = model.transforms[..., :3]
    mean = np.einsum("tjca,tjcb->jab", linear, linear) / len(linear)
    if kind == "affine":
        np.testing.assert_allclose(mean, np.tile(np.eye(3), (2, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.trace(mean, axis1=1, axis2=2), 3, atol=1e-9)
    check_kind(model.transforms, kind)
    np.testing.assert_allclose(  # parts stay where they were
        model.rest[:20].mean(axis=0), rest[:20].mean(axis=0), atol=1e-9
    )
    again = model.copy()
    for held in (FREE, Constraints(bone_model="affine", lock_rest=True)):
        normalise_gauge(again, importance, held)
        assert np.array_equal(again.rest, model.rest)


def test_result_is_in_that_gauge() -> None:
    result = ssdr.decompose(rig("affine").frames, bones=4, bone_model="affine", effort="fast")
    s = result.skinning
    mass = np.asarray(s.sparse_weights().sum(axis=0)).ravel()
    linear = s.transforms[..., :3]
    mean = np.einsum("j,tjca,tjcb->ab", mass / mass.sum(), linear, linear) / len(linear)
    np.testing.assert_allclose(mean, np.eye(3), atol=1e-6)
