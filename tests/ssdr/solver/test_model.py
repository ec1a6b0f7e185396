"""The model that the steps change."""

from __future__ import annotations

import numpy as np

from ssdr.solver.model import Model


def test_what_is_left_of_a_model_shares_no_memory() -> None:
    """With 12 influences and more, joints were the support itself, and steps wrote to both."""
    rng = np.random.default_rng(0)
    for influences in (4, 12, 13):
        model = Model.start(
            rng.standard_normal((3, 14, 3, 4)),
            rng.standard_normal((30, 3)),
            rng.integers(0, 14, 30),
            influences,
        )
        smaller = model.without(np.array([3]))
        arrays = [a for m in (model, smaller) for a in vars(m).values()]
        for k, a in enumerate(arrays):
            assert not any(np.shares_memory(a, b) for b in arrays[k + 1 :])
