"""The model that the steps change."""

from __future__ import annotations

import numpy as np

from ssdr.solver.model import Constraints, Lowest, Model


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


def test_the_lowest_is_a_copy_that_later_steps_do_not_change() -> None:
    model, lowest = (
        Model.start(np.zeros((2, 1, 3, 4)), np.zeros((5, 3)), np.zeros(5, int), 1),
        Lowest(),
    )
    assert not lowest.exists
    assert lowest.offer(model, 2.0)
    model.rest += 1.0
    assert not lowest.offer(model, 2.0)
    assert not lowest.offer(model, float("nan"))
    assert (lowest.model.rest == 0).all()
    assert lowest.offer(model, 1.5)
    assert (lowest.model.rest == 1).all()
    assert lowest.value == 1.5


def test_masks_of_what_is_locked_reach_as_far_as_asked() -> None:
    constraints, some = Constraints(weights=np.array([True, False])), np.array([1, 0])
    assert constraints.select_vertices(some).vertex_mask(2).tolist() == [False, True]
    assert Constraints().select_vertices(some).vertex_mask(2).tolist() == [False, False]
