"""The penalty on weights that jump."""

from __future__ import annotations

import numpy as np

import ssdr
from ssdr.solver.model import Model
from ssdr.solver.objective import WeightSmoothness
from ssdr.solver.trajectories import gather


def test_the_penalty_of_equal_weights_is_not_below_zero() -> None:
    """It is a difference of equal sums, and its root is taken."""
    rng = np.random.default_rng(0)
    for n in (4, 30, 100):
        faces = rng.integers(0, n, (2 * n, 3)).astype(np.int32)
        data = gather([ssdr.MeshSequence(rng.standard_normal((2, n, 3)), faces)], bones=3)
        smooth = WeightSmoothness.build(data, faces, 1.0)
        model = Model.start(
            rng.standard_normal((2, 3, 3, 4)),
            rng.standard_normal((n, 3)),
            np.zeros(n, dtype=int),
            3,
        )
        for _ in range(50):
            shares = np.sort(rng.dirichlet(np.ones(3)))[::-1]
            model.indices[:], model.weights[:] = np.arange(3), shares
            assert smooth is not None
            assert 0 <= smooth.penalty(model) < 1e-9
