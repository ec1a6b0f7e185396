"""Influences that are dropped."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers.measures import rmse_of, solved, wavy
from ssdr.parsimony.pruning import FewerInfluences
from ssdr.solver.model import Constraints
from ssdr.solver.trajectories import gather


def test_dropped_influences_cost_what_is_said() -> None:
    data = gather([ssdr.MeshSequence(wavy())], bones=5)
    nested = FewerInfluences(data, solved(data, 5), Constraints())
    assert (np.diff(nested.counts, axis=0) <= 0).all()
    assert (nested.counts[-1] == 1).all()
    assert (np.diff(nested.errors.sum(axis=1)) > 0).all()
    cheap, none = nested.choose(0.0)
    assert none == pytest.approx(nested.errors.min(axis=0).sum())
    level, error = nested.choose(1e-4)
    assert (level >= cheap).all()
    model = nested.build(level)
    rest, transforms = data.alignment.to_world(model.rest, model.transforms)
    built = ssdr.Skinning(rest, model.indices, model.weights, transforms)
    count = 15 * 84
    assert rmse_of(built, wavy()) == pytest.approx(
        data.alignment.scale * np.sqrt(error / count), rel=1e-6
    )
    assert (model.weights > 0).sum() == np.take_along_axis(nested.counts, level[None], 0).sum()
