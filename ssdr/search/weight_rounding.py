"""The last steps of a run whose weights are stored in integers."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from ..problem.answer import Step
from ..problem.problem import Problem
from ..problem.progress import ProgressReport
from ..solver.model import Model
from ..solver.rounding import rounded_models
from .descent import Descent
from .efforts import NUMBERS

__all__ = ["rounded_best"]


def rounded_best(
    problem: Problem, d: Descent, report: ProgressReport, reason: str
) -> tuple[Model, list[Step], str]:
    """The best model of a descent with the weights that the problem's storage holds.

    Returns
    -------
    Model
    list of Step
        Steps of the descent, and one for the rounding.
    str
        `reason`, or "cancelled" or "time limit" if that ended the rounding.
    """
    best, data, steps = d.best_model, d.data, list(d.records)
    if problem.storage == "float32":
        return best, steps, reason
    unit = data.scale / math.sqrt(data.n_frames * data.n_vertices)
    phase, rounds = "round weights", NUMBERS[problem.effort].rounding
    locked = problem.locked
    if problem.smoothness > 0:  # which an exchange of units would not know
        locked = dataclasses.replace(locked, weights=np.ones(data.n_vertices, dtype=bool))
    for model in rounded_models(data, best, problem.storage, locked=locked, rounds=rounds):
        error = model.weighted_error(data)
        rmse = unit * math.sqrt(error)
        stopped = report(phase, iteration=d.iteration, rmse=rmse, fraction=1.0)
        if stopped or report.out_of_time:
            reason = "cancelled" if stopped else "time limit"
            break
    return model, [*steps, (d.iteration, d.clock.elapsed, error, phase)], reason
