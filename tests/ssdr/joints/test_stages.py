"""Stages of bones that hang on joints."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr
from helpers import motions
from ssdr.drivers.schedule import FIRST_MODEL
from ssdr.joints.stages import Contend
from ssdr.search.prescribed import Prescribed
from ssdr.search.run import Run
from ssdr.solver.model import Fixed, Model
from ssdr.solver.trajectories import gather


@pytest.mark.parametrize("best", [0, 1, 2])
def test_the_lowest_of_several_starts_goes_on(best: int) -> None:
    data = gather([ssdr.MeshSequence(motions.chain(bones=3, frames=8).frames)], bones=3)
    stages = (Contend(), Contend(), Contend(last=True))
    run = Run(
        data,
        [*FIRST_MODEL, *stages],
        bones=3,
        influences=2,
        rng=np.random.default_rng(0),
        fixed=Fixed(),
        prescribed=Prescribed(),
    )
    run.position = len(FIRST_MODEL)
    starts = [_model(data, 1.0 if k == best else 2.0 + k) for k in range(3)]
    for k, start in enumerate(starts):
        run.model = start
        run.advance()
        assert (run.aside is None) == (k == 2)
    assert run.finished
    assert np.array_equal(run.present.error, starts[best].error)


def _model(data, error: float) -> Model:
    moves = np.zeros((data.n_frames, 3, 3, 4))
    moves[..., :3] = np.eye(3)
    model = Model.start(moves, data.frame(0), np.arange(data.n_vertices) % 3, 2)
    model.error[:] = error
    return model
