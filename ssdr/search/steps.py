"""Steps of a descent on all bones together, and on which vertices and model the next ones work."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from ..solver.alternation import repeat_alternation, vertex_step
from ..solver.gauge import free_gauge
from ..solver.gauss_newton import GaussNewton
from ..solver.rest_normals import with_rest_normals
from ..solver.vertex_newton import optimise_some
from .descent import Descent, Schedule, step
from .moves import polish_then_drop_influence
from .vertex_sample import LEAST, MOST, model_of_all, motion_sample, sample_size

__all__ = [
    "all_vertices",
    "alternate",
    "beside",
    "compress",
    "lowest",
    "polish",
    "relax",
    "return_to_best",
    "sample_vertices",
    "solve_normals",
    "unfold",
]

# Relative decrease of the objective below which an alternation counts as a failure.
_PLATEAU = 1e-5
# Failures in a row that end the alternations: with fewer, they would end at a pause.
_PLATEAU_ALTERNATIONS = 3
_UNFOLD_ROUNDS = 4  # solves of weights and rest pose after the edges have become stiffer


# --- all bones -----------------------------------------------------------------------------------


@step("compress", cost=4)
def compress(d: Descent) -> Iterator[None]:
    """Compress the trajectories to as few columns as the bones need: later steps take less time."""
    d.full = d.data = d.full.compressed(d.bones)
    yield


@step("alternate")
def alternate(d: Descent, *, steps: int, gain: float = _PLATEAU) -> Iterator[None]:
    """Alternation of Le and Deng: solve the bones, then the weights and the rest pose.

    Three alternations in a row that lower the objective by less than the share `gain` are the last.
    """
    failures = 0
    for _ in range(steps):
        before = d.value(d.model)
        repeat_alternation(d.data, d.model, 1, d.locked, d.smoothness)
        free_gauge(d.data, d.model, d.locked)
        d.iteration += 1
        still = before - d.value(d.model) < max(gain, _PLATEAU) * before
        failures = failures + 1 if still else 0
        d.converged = failures >= _PLATEAU_ALTERNATIONS
        yield
        if d.converged:
            return


@step("polish", cost=6)
def polish(d: Descent, *, steps: int, gain: float = 0.0) -> Iterator[None]:
    """Improve all bones together by Gauss–Newton steps with variable projection.

    It ends when eight steps lower the error by less than the share `gain`.
    """
    newton = GaussNewton(d.data, d.model, locked=d.locked)
    for _ in newton.steps(steps, gain=gain):
        d.iteration += 1
        d.converged = newton.converged
        yield


@step("relax", cost=40)
def relax(d: Descent, *, steps: int = 4, polish_steps: int = 8) -> Iterator[None]:
    """Polish with up to `steps` more influences, at most twice as many, and give up one at a time.

    There are `polish_steps` polish steps at each number of influences.  More influences would take
    much memory, since a polish holds (K + 2)² numbers per vertex for K influences.
    """
    k = d.influences
    model = d.model.with_influences(min(2 * k, k + steps, d.model.n_bones))
    for _ in range(max(1, model.n_influences - k)):
        if model.n_influences > k:
            model = polish_then_drop_influence(d.data, model, d.locked, steps=polish_steps)
            d.iteration += polish_steps
        d.model = model
        yield
        model = d.model


@step("normals", cost=4)
def solve_normals(d: Descent) -> Iterator[None]:
    """Solve rest normals, too, from now on, if they are wanted and bones are rigid.

    They come late, since they lead a search for places of bones to models with more error.
    """
    if not (d.normals and len(d.full.faces) and d.asked.bone_model == "rigid"):
        return
    d.full = d.data = d.full.with_normals()
    d.model = with_rest_normals(d.data, d.model)
    if d.best is not None:
        d.best = with_rest_normals(d.data, d.best)
        d.best_value = d.value(d.best)
    yield


@step("unfold", cost=3)
def unfold(d: Descent, *, steps: int = 8) -> Iterator[None]:
    """Turn triangles of the rest pose back that are turned over, by ten times stiffer edges there.

    It makes the best model the one that is returned, as a rest pose with folds is no surface.
    """
    if d.full.surface is None:
        return
    d.model, locked = d.best_model.with_restarted_support(), d.locked
    if d.smoothness is not None:  # which this solve of weights would not know
        every = np.ones(d.full.n_vertices, dtype=bool)
        locked = dataclasses.replace(locked, weights=every)
    for _ in range(steps):
        assert d.full.surface is not None
        turned = d.full.surface.turned(d.model.rest, d.full.faces)
        if not turned.any():
            return
        surface = d.full.surface.stiffened(d.full.faces[turned])
        d.full = d.data = dataclasses.replace(d.full, surface=surface)
        # far from the stiffer edges nothing has changed
        near = surface.around(d.full.faces[turned])
        optimise_some(d.data, d.model, near, locked=locked, times=_UNFOLD_ROUNDS)
        d.keep_present()
        yield


# --- which vertices, which model -----------------------------------------------------------------


@step("sample")
def sample_vertices(d: Descent, *, least: int = LEAST, most: int = MOST) -> Iterator[None]:
    """Work on a third of the vertices, spread evenly over the range of motion.

    There are at least `least` and at most `most` for each bone asked for.

    A sample is enough to tell where bones belong.  If the bounds ask for half of the vertices or
    more, all are used.
    """
    count = sample_size(d.full.n_vertices, d.bones, least, most)
    if 2 * count < d.full.n_vertices:
        d.chosen = motion_sample(d.full, count)
        d.data = d.full.select_vertices(d.chosen)
        d.model = d.model.select_vertices(d.chosen)
    yield


@step("all vertices", cost=8)
def all_vertices(d: Descent, *, alternations: int = 4) -> Iterator[None]:
    """Work on all vertices again; each starts with the weights of the nearest sampled vertex."""
    few, chosen, initial = d.model, d.chosen, d.initial.beside_model()
    d.data, d.chosen = d.full, None
    if chosen is not None:
        rest = initial.first_pose(d.data)
        model = model_of_all(few, rest, chosen)
        if initial.rest is not None:
            model.rest = rest
        vertex_step(d.data, model, locked=d.locked)
        repeat_alternation(d.data, model, alternations, d.locked)
        d.iteration += alternations
        d.model = model
    yield


@step("return to best", cost=0)
def return_to_best(d: Descent) -> Iterator[None]:
    """Continue from the best model so far.

    While a sample of vertices is used, this is done only if the best model has less error on the
    sample than the present model.
    """
    best = d.best_model
    if d.chosen is not None:
        best = best.select_vertices(d.chosen)
        if best.weighted_error(d.data) >= d.model.weighted_error(d.data):
            yield
            return
    d.model = best.with_restarted_support()
    yield


def lowest(d: Descent, *starts: Schedule) -> None:
    """Follow several schedules in turn; continue from the model of least objective."""
    kept, least = None, np.inf
    for start in starts:
        start(d)
        if d.below(least, expected=False):
            kept, least = d.model.copy(), d.value(d.model)
    if kept is not None:
        d.model = kept


def beside(d: Descent, start: Schedule) -> None:
    """Follow a schedule from another start; keep the best model before it unless errors fall."""
    before, value, known = d.best, d.best_value, len(d.records)
    start(d)
    if before is not None and d.best_error > before.weighted_error(d.full):
        d.best, d.best_value = before, value
        del d.records[known:]
