"""Weights rounded to multiples of a file's smallest step, with all else solved again.

Rounding costs much where bones pull against each other: a weight that is off by δ moves the vertex
by δ |M_j p̃ − v|, however small the error was.  A penalty on these distances draws the bones
together before the weights are rounded.  Afterwards single steps (units) of weight move from one
bone of a vertex to another while its error falls, each time with the best rest position.  Then the
model is polished while half of the vertices keep their rounded weights, and again while all do.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..kernels.rounding import move_units
from ..parallel import chunk_bounds, run_chunks, serial_blas
from ..quantisation import WeightStorage, is_stored, quantise, weight_values
from .gauss_newton import GaussNewton
from .model import ARRAYS, CHUNK, SOLVED, Constraints, Lowest, Model
from .moments import transform_sums
from .objective import Objective, normal_length, rest_pulls
from .trajectories import Trajectories

_STEPS = 8  # polish steps of a round
# Most rounds after the weights are rounded, for each round before that; they end early if the
# relative gain of a round is smaller than _GAIN.
_AFTER, _GAIN = 12, 4e-4
# Assumed mean square, in units, of the change of a weight by rounding: 1/12 for rounding to the
# nearest, and far less if all else is solved again.  With 1/6, 1/24 and 1/100, mannequin_rumba with
# 30 bones has 1.19, 1.14 and 1.13 times the E of float weights after equal work; ea_bone is best at
# 1/24.
_NOISE = 1 / 50


def rounded_models(
    data: Trajectories,
    model: Model,
    storage: WeightStorage,
    *,
    constraints: Constraints,
    rounds: int,
) -> Iterator[Model]:
    """Yield models with weights rounded for `storage`; the first comes quickly.

    The objective never rises from one model to the next.

    Parameters
    ----------
    data : Trajectories
    model : Model
        The model to round, which is not changed.
    storage : {"uint8", "uint16"}
    constraints : Constraints
        Locked weights are rounded to the nearest.
    rounds : int
        Number of rounds of polish steps before the weights are rounded; up to twelve times as many
        follow.  If it is 0, or the weights need no rounding, only weights and rest pose are solved
        again.
    """
    objective = Objective(constraints)
    best, trial = Lowest(), _rounded(data, model, storage, constraints)
    best.offer(trial, objective.value(data, trial))
    yield best.model
    whole = is_stored(model.weights, storage)
    if rounds == 0 or whole or best.value <= (1 + _GAIN) * objective.value(data, model):
        return
    drawn = model.copy()
    for _ in range(rounds):
        _draw_together(data, drawn, storage, constraints)
        yield best.model
    trial = _rounded(data, drawn, storage, constraints)
    rng, stay = np.random.default_rng(0), constraints.vertex_mask(data.n_vertices)
    for left in reversed(range(_AFTER * rounds + 1)):
        before = best.value
        if best.offer(trial, objective.value(data, trial)):
            yield best.model
            if before - best.value < _GAIN * best.value:
                return
        if left == 0:
            return
        trial = best.model
        half = rng.random(data.n_vertices) < 0.5  # these keep their weights; the others adapt
        for mask, units in ((stay | half, stay | half), (np.ones_like(stay), stay)):
            trial = trial.copy()
            GaussNewton(
                data, trial, constraints=dataclasses.replace(constraints, weights=mask)
            ).run(_STEPS)
            trial = _rounded(data, trial, storage, dataclasses.replace(constraints, weights=units))


@serial_blas()
def _rounded(
    data: Trajectories, model: Model, storage: WeightStorage, constraints: Constraints
) -> Model:
    """A copy with rounded weights.

    At vertices that are not locked, units of weight are then moved between bones to lower the
    error.
    """
    indices, stored = quantise(model.indices, model.weights, storage)
    out = dataclasses.replace(model.copy(), indices=indices, weights=weight_values(stored))
    _, gram, _, reduced = transform_sums(data, out.transforms)
    pairs = np.ascontiguousarray(gram.transpose(0, 2, 1))
    keep, steps = constraints.vertex_mask(data.n_vertices), np.iinfo(storage).max
    length, hold = normal_length(data, model), rest_pulls(data, model, constraints)

    def work(_: int, i: int, k: int) -> None:
        some = slice(i, k)
        sums = data.products(some, reduced, length), data.squares(some, length)
        rows = [getattr(out, name)[some] for name in SOLVED]
        held = hold[some], length, keep[some]
        arrays: Any = *sums, pairs, *rows, *held, not constraints.rest, steps
        move_units(*arrays)

    run_chunks(work, chunk_bounds(data.n_vertices, CHUNK))
    for error in (out.error, out.normal_error):
        np.maximum(error, 0.0, out=error)
    out.restart_support()
    return out


def _draw_together(
    data: Trajectories, model: Model, storage: WeightStorage, constraints: Constraints
) -> None:
    """Polish under a penalty on the distances |M_j p̃ − v| of all influences (in place).

    The penalty is the error of additional vertices: copies of a vertex v, each moved by one of its
    bones j alone.  To save time, every (K + 1)-th influence is copied, with K + 1 times the weight.
    """
    n, k = model.weights.shape
    vertex, slot = (axis[:: k + 1] for axis in np.nonzero(model.weights))
    rows = np.concatenate([np.arange(n), vertex])
    wide = model.select_vertices(rows)
    wide.indices[n:], wide.weights[n:] = 0, 0.0
    wide.indices[n:, 0], wide.weights[n:, 0] = model.indices[vertex, slot], 1.0
    wide.restart_support()
    importance = data.importance[rows]
    importance[n:] *= (k + 1) * _NOISE / np.iinfo(storage).max ** 2
    mask = np.concatenate([constraints.vertex_mask(n), np.ones(len(vertex), dtype=bool)])
    surface = None if data.surface is None else data.surface.extended(rows)
    GaussNewton(
        dataclasses.replace(data.select_vertices(rows), importance=importance, surface=surface),
        wide,
        constraints=dataclasses.replace(constraints, weights=mask),
    ).run(_STEPS)
    narrow = wide.select_vertices(np.arange(n))
    for name in ARRAYS:
        setattr(model, name, getattr(narrow, name))
    model.tree = narrow.tree
