"""Changes of a model that a search tries: bones that grow, influences that come and go."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from helpers import naive
from helpers.blends import BONES, INFLUENCES, problem, squared_error
from helpers.measures import descent_of
from ssdr.search import steps as search_steps
from ssdr.search.moves import (
    add_and_merge_bones,
    alternate_some,
    drop_influence,
    exchange_bones,
    exchange_influences,
    move_cheapest_bone,
    polish_steps,
)
from ssdr.solver.model import FREE, Constraints, Model
from ssdr.solver.trajectories import Trajectories

Change = Callable[[Trajectories, Model, np.random.Generator, Constraints], Model]


@pytest.mark.parametrize("count", [INFLUENCES, INFLUENCES + 1, 15])
def test_room_for_influences_and_back_is_the_same_model(count: int) -> None:
    _, model = problem(0)
    wide = model.with_influences(count)
    assert wide.n_influences == count
    assert wide.support.shape[1] >= count
    assert (wide.weights[:, INFLUENCES:] == 0).all()
    back = wide.with_influences(INFLUENCES)
    for name in ("transforms", "rest", "indices", "weights", "error"):
        assert np.array_equal(getattr(back, name), getattr(model, name))


def test_fewer_influences_keep_the_largest() -> None:
    _, model = problem(0)
    rng = np.random.default_rng(0)
    model = model.with_influences(4)
    model.indices[:] = np.argsort(rng.random((90, BONES)), axis=1)[:, :4]
    model.weights[:] = rng.dirichlet(np.ones(4), size=90)
    small = model.with_influences(2)
    for i in range(90):
        largest = sorted(zip(model.weights[i], model.indices[i], strict=True))[-2:]
        total = sum(w for w, _ in largest)
        found = {int(j): w for j, w in zip(small.indices[i], small.weights[i], strict=True)}
        assert found == pytest.approx({int(j): w / total for w, j in largest})


def relax(
    data: Trajectories, model: Model, constraints: Constraints, *, extra: int, steps: int
) -> tuple[Model, int]:
    """A relaxed copy, and the number of steps."""
    d = descent_of(data, BONES, INFLUENCES, constraints=constraints)
    d.model = model.copy()
    phases: list[str] = []
    d.follow(partial(search_steps.relax, steps=extra, polish_steps=steps), phases.append)
    return d.model, len(phases)


@pytest.mark.parametrize("extra", [0, 1, 4, 50])
def test_relaxed_model_is_one_of_the_same_size(extra: int) -> None:
    data, model = problem(1)
    before = model.copy()
    relaxed, steps = relax(data, model, FREE, extra=extra, steps=2)
    assert steps == max(1, min(extra, INFLUENCES))
    assert relaxed.n_influences == INFLUENCES
    assert relaxed.n_bones == BONES
    assert (relaxed.weights >= 0).all()
    assert relaxed.weights.sum(axis=1) == pytest.approx(1.0)
    assert relaxed.weighted_error(data) == pytest.approx(squared_error(data, relaxed), rel=1e-6)
    for name in ("transforms", "rest", "indices", "weights", "error"):
        assert np.array_equal(getattr(before, name), getattr(model, name))


def test_relaxing_leaves_kept_weights_alone() -> None:
    data, model = problem(2)
    keep = np.zeros(90, dtype=bool)
    keep[::3] = True
    constraints = Constraints(weights=keep)
    relaxed, _ = relax(data, model, constraints, extra=2, steps=2)
    assert np.array_equal(relaxed.indices[keep], model.indices[keep])
    assert np.array_equal(relaxed.weights[keep], model.weights[keep])


def test_relaxing_finds_what_the_polish_alone_does_not() -> None:
    gains = []
    for seed in range(10):
        data, model = problem(seed)
        plain = model.copy()
        polish_steps(data, plain, 40, FREE)
        relaxed, _ = relax(data, model, FREE, extra=2, steps=8)
        polish_steps(data, relaxed, 24, FREE)
        gains.append(relaxed.weighted_error(data) / plain.weighted_error(data))
    assert np.exp(np.mean(np.log(gains))) < 0.9


def rebuild(
    data: Trajectories, model: Model, rng: np.random.Generator, constraints: Constraints
) -> Model:
    return add_and_merge_bones(data, model, rng, constraints)


CHANGES = (exchange_bones, alternate_some, exchange_influences, rebuild)


@pytest.mark.parametrize("change", CHANGES)
def test_changes_go_by_the_generator_alone_and_keep_the_size(change: Change) -> None:
    data, model = problem(3)
    before = model.copy()
    one, same, other = (change(data, model, np.random.default_rng(s), FREE) for s in (1, 1, 2))
    assert np.array_equal(one.transforms, same.transforms)
    assert not np.array_equal(one.transforms, other.transforms)
    for name in ("transforms", "rest", "indices", "weights", "error"):
        assert np.array_equal(getattr(before, name), getattr(model, name))
    for changed in (one, other):
        assert (changed.n_bones, changed.n_influences) == (BONES, INFLUENCES)
        assert (changed.weights >= 0).all()
        assert changed.weights.sum(axis=1) == pytest.approx(1.0)
        assert changed.weighted_error(data) == pytest.approx(squared_error(data, changed), rel=1e-6)


def test_rebuilding_finds_what_exchanges_of_one_bone_do_not() -> None:
    ratios = []
    for seed in range(5):
        data, model = problem(seed)
        exchanged, rebuilt = model.copy(), model.copy()
        rng = np.random.default_rng(seed)
        for _ in range(40):
            trial = move_cheapest_bone(data, exchanged, rng, FREE)
            assert trial is not None
            if trial.weighted_error(data) < exchanged.weighted_error(data):
                exchanged = trial
        for _ in range(10):
            trial = rebuild(data, rebuilt, rng, FREE)
            if trial.weighted_error(data) < rebuilt.weighted_error(data):
                rebuilt = trial
        ratios.append(rebuilt.weighted_error(data) / exchanged.weighted_error(data))
    assert np.median(ratios) < 0.9


def test_the_dropped_influence_is_the_one_that_is_missed_least() -> None:
    """Against each of them left out in turn, weights and position solved at length."""
    data, model = problem(5)
    model = model.with_influences(INFLUENCES + 1)
    polish_steps(data, model, 10, FREE)
    full = (model.weights > 0).all(axis=1)
    assert full.sum() > 20
    dropped = model.copy()
    drop_influence(data, dropped, FREE)
    ratios = []
    for i in range(90):
        if not full[i]:
            assert np.array_equal(dropped.indices[i], model.indices[i])
            assert np.array_equal(dropped.weights[i], model.weights[i])
            continue
        kept = set(dropped.indices[i][dropped.weights[i] > 0].tolist())
        assert kept < set(model.indices[i].tolist())
        least = min(without_slot(data, model, i, q) for q in range(INFLUENCES + 1))
        ratios.append(dropped.error[i] / least)
    # two rounds of Gauss–Newton, and not as many as it takes
    assert np.quantile(ratios, 0.9) < 1.001
    assert max(ratios) < 1.1


def without_slot(data: Trajectories, model: Model, i: int, q: int) -> float:
    """Squared error of vertex i without its q-th bone, by alternating least squares."""
    bones = np.delete(model.indices[i], q)
    weights = np.delete(model.weights[i], q)
    weights = weights / weights.sum()
    target = np.stack([data.frame(t)[i] for t in range(data.n_frames)])[:, None]
    transforms = model.transforms[:, bones]
    every = np.arange(len(bones))[None]
    for _ in range(30):
        p = naive.rest_position(target, every, weights[None], transforms)
        moved = naive.bone_images(p, transforms)[0]
        _, weights = naive.best_convex(moved, target.ravel(), len(bones))
    return float(naive.squared_error(target, p, every, weights[None], transforms)[0])
