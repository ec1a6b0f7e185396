"""Weights in whole units: the moves of units, and the models that are solved for them."""

from __future__ import annotations

import numpy as np
import pytest

from helpers import blends, naive
from ssdr.kernels.rounding import move_units
from ssdr.quantisation import quantise, weight_values
from ssdr.solver.model import FREE, Constraints
from ssdr.solver.moments import transform_sums
from ssdr.solver.rounding import rounded_models


@pytest.mark.parametrize("move_rest", [True, False])
def test_moves_of_units_agree_with_a_naive_twin(move_rest: bool) -> None:
    data, model = blends.problem(3)
    some = np.arange(24)
    data, model = data.select_vertices(some), model.select_vertices(some)
    frames = np.stack([data.frame(t) for t in range(data.n_frames)])
    steps, influences, constraints = 15, 3, some % 5 == 0
    units = np.zeros((len(some), model.n_bones), dtype=int)
    for row, rng in zip(units, np.random.default_rng(0).spawn(len(some)), strict=True):
        few = rng.permutation(model.n_bones)[: rng.integers(1, influences + 1)]
        row[few] = 1 + rng.multinomial(steps - len(few), np.full(len(few), 1 / len(few)))
    expected, errors = naive.move_units(
        frames, model.rest, units, model.transforms, influences, move_rest=move_rest
    )
    expected[constraints] = units[constraints]
    indices = np.argsort(-units, axis=1, kind="stable")[:, :influences].astype(np.int32)
    weights = np.take_along_axis(units, indices, axis=1) / steps
    _, gram, _, reduced = transform_sums(data, model.transforms)
    sums = data.products(some, reduced, 0.0), data.squares(some, 0.0)
    pairs = np.ascontiguousarray(gram.transpose(0, 2, 1))
    rest, error, free = model.rest.copy(), np.zeros(len(units)), np.zeros((len(units), 4))
    rows = rest, indices, weights, error, model.normals, model.normal_error
    move_units(*sums, pairs, *rows, free, 0.0, constraints, move_rest, steps)
    found = np.zeros(units.shape)
    np.add.at(found, (some[:, None], indices), weights)
    np.testing.assert_allclose(found, expected / steps, atol=1e-12)
    assert (found[~constraints] != units[~constraints] / steps).any()
    np.testing.assert_allclose(error[~constraints], errors[~constraints], rtol=1e-6)
    true = naive.squared_error(frames, rest, indices, weights, model.transforms)
    np.testing.assert_allclose(error, true, rtol=1e-6)
    assert (np.diff(weights, axis=1) <= 0).all()


def test_models_fall_and_the_first_beats_plain_rounding() -> None:
    data, model = blends.problem(1)
    model.error[:] = naive.squared_error(
        np.stack([data.frame(t) for t in range(data.n_frames)]),
        model.rest, model.indices, model.weights, model.transforms,
    )  # fmt: skip
    indices, stored = quantise(model.indices, model.weights, "uint8")
    plain = model.copy()
    plain.indices, plain.weights = indices, weight_values(stored)
    errors = []
    for found in rounded_models(data, model, "uint8", constraints=FREE, rounds=2):
        errors.append(blends.squared_error(data, found))
        units = 255 * found.weights
        np.testing.assert_allclose(units, np.rint(units), atol=1e-9)
        assert (np.rint(units).sum(axis=1) == 255).all()
    assert errors[0] < blends.squared_error(data, plain)
    assert (np.diff(errors) <= 1e-12).all()


def test_locked_parts_stay() -> None:
    data, model = blends.problem(2)
    weights = np.arange(len(model.rest)) < 40
    constraints = Constraints(rest=True, weights=weights, bones=np.arange(model.n_bones) < 3)
    model.error[:] = 1e-3
    *_, found = rounded_models(data, model, "uint8", constraints=constraints, rounds=1)
    indices, stored = quantise(model.indices, model.weights, "uint8")
    np.testing.assert_array_equal(found.indices[:40], indices[:40])
    np.testing.assert_allclose(found.weights[:40], weight_values(stored)[:40], atol=1e-15)
    np.testing.assert_array_equal(found.rest, model.rest)
    np.testing.assert_array_equal(found.transforms[:, :3], model.transforms[:, :3])
