"""The error that a tolerance leaves is spent on bytes: fewer influences, fewer keyframes.

One multiplier λ, the price of a byte, decides on both: of all ways to store a vertex's weights or
a bone's keys the one of least error + λ · bytes is chosen (Everett 1963).  The price is raised
while the models that it leads to hold the tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..search.moves import drop_influence
from ..skinning import Skinning
from ..solver.gauss_newton import GaussNewton
from ..solver.model import Locked, Model
from ..solver.trajectories import Trajectories
from .keyframes import Tracks
from .report import Pruning, influence_bytes, size
from .solved_frames import SolvedFrames

__all__ = ["Nested", "Pruner"]

# Prices of a byte that are tried: enough to come within a fifth of the best one; where each trial
# walks over all frames, as few as bracket it.
_PRICES, _FEW_PRICES = 12, 3
_DEARER, _CHEAPER = 2.0, 0.25  # factors of the price until one holds and another does not
_CLOSE_PRICES = 1.2  # ratio of the prices on either side of the best at which the search ends
_HALVINGS = 8  # of the range in which the first price is guessed, 40 doublings
_SETTLE = 6  # polish steps after influences are dropped
_DAMPING = 1e-3  # first damping of that polish, as in the solver


class Nested:
    """A model with fewer and fewer influences at every vertex.

    Parameters
    ----------
    data : Trajectories
    model : Model
    locked : Locked

    Attributes
    ----------
    models : list of Model
        The m-th has at most K − m influences a vertex, each the best to drop after those before.
    errors : (K, V) float64
    counts : (K, V) int
    """

    def __init__(self, data: Trajectories, model: Model, locked: Locked) -> None:
        self.importance = data.importance
        self.models = [model.copy()]
        while self.models[-1].n_influences > 1:
            fewer = self.models[-1].copy()
            drop_influence(data, fewer, locked)
            self.models.append(fewer.with_influences(fewer.n_influences - 1))
        self.errors = np.maximum(np.stack([m.error for m in self.models]), 0.0)
        self.counts = np.stack([(m.weights > 0).sum(axis=1) for m in self.models])

    def choose(self, price: float) -> tuple[NDArray[np.intp], float]:
        """The level of each vertex of least error + price · influences, and the squared error."""
        cost = self.errors * self.importance + price * self.counts
        # of equal costs the one of fewer influences
        level = len(cost) - 1 - cost[::-1].argmin(axis=0)
        least = np.take_along_axis(self.errors, level[None], axis=0)[0]
        return level, float(self.importance @ least)

    def build(self, level: NDArray[np.intp]) -> Model:
        """The model whose vertices have these levels."""
        out = self.models[0].copy()
        for m, model in enumerate(self.models):
            rows = level == m
            model = model.with_influences(out.n_influences)
            for name in ("rest", "indices", "weights", "error"):
                getattr(out, name)[rows] = getattr(model, name)[rows]
        out.restart_support()
        return out


class Pruned(NamedTuple):
    """A skinning with fewer influences, one with fewer keys as well, and their errors."""

    fewer: Skinning
    keyed: Skinning
    error: float
    keyed_error: float


class Pruner:
    """Search for the price of a byte that uses up what a model leaves of the tolerance.

    Parameters
    ----------
    frames : SolvedFrames
    model : Model
        The one that holds the tolerance.
    tolerance : float
    skinning_of_all : callable
        Makes a skinning of all frames from a model.
    """

    def __init__(
        self,
        frames: SolvedFrames,
        model: Model,
        tolerance: float,
        skinning_of_all: Callable[[Model], Skinning],
    ) -> None:
        self.frames, self.tolerance, self.skinning_of_all = frames, tolerance, skinning_of_all
        self.locked, self.offsets = frames.problem.locked, frames.problem.offsets
        self.nested = Nested(frames.data, model, self.locked)

    def run(self, skinning: Skinning) -> tuple[Skinning, list[Pruning]]:
        """The smallest model of a search over prices, and what each pruning cost.

        `skinning` is the model, of all frames.
        """
        before = self.frames.error_of_all(skinning)
        best = Pruned(skinning, skinning, before, before)
        price = self._guess(skinning)
        low = high = None
        streamed = self.frames.scan is not None
        for _ in range(_FEW_PRICES if streamed else _PRICES):
            trial = self._pruned(price)
            if max(trial.error, trial.keyed_error) > self.tolerance:
                high = price
            else:
                low = price
                if size(trial.keyed).total < size(best.keyed).total:
                    best = trial
                if streamed:
                    break
            if low is None or high is None:
                price *= _CHEAPER if low is None else _DEARER
            elif high < _CLOSE_PRICES * low:
                break
            else:
                price = math.sqrt(low * high)
        return best.keyed, [
            _pruning("influences", skinning, best.fewer, before, best.error),
            _pruning("keyframes", best.fewer, best.keyed, best.error, best.keyed_error),
        ]

    def _guess(self, skinning: Skinning) -> float:
        """The price at which what both choices add, each by itself, uses up the tolerance."""
        frames, nested, data = self.frames, self.nested, self.frames.data
        left = self.tolerance**2 - frames.error_of_all(skinning, "rmse") ** 2
        budget = max(left, 1e-300) * skinning.n_frames * skinning.n_vertices
        tracks = Tracks(skinning, self.offsets)
        # representative frames stand for all
        unit = data.scale**2 * skinning.n_frames / data.n_frames
        influence = influence_bytes(skinning.n_bones) / unit
        least = nested.choose(0.0)[1]
        low, high = 1e-12 * budget, budget
        for _ in range(_HALVINGS):
            price = math.sqrt(low * high)
            added = (nested.choose(price * influence)[1] - least) * unit
            holds = added + tracks.choose(price)[1] <= budget
            low, high = (price, high) if holds else (low, price)
        return low

    def _pruned(self, price: float) -> Pruned:
        data, nested = self.frames.data, self.nested
        influence = influence_bytes(nested.models[0].n_bones) / data.scale**2
        model = nested.build(nested.choose(price * influence)[0])
        if self.frames.measure == "rmse":  # a polish lowers the sum, and may raise the largest
            # a damping handed over: no bone enters, supports stay as they are
            polish = GaussNewton(data, model, locked=self.locked, damping=_DAMPING)
            for _ in range(_SETTLE):
                polish.step(entering=0)
        fewer = self.skinning_of_all(model)
        error = self.frames.error_of_all(fewer)
        if error > self.tolerance:
            return Pruned(fewer, fewer, error, error)
        tracks = Tracks(fewer, self.offsets)
        keyed = tracks.play(tracks.choose(price)[0])
        return Pruned(fewer, keyed, error, self.frames.error_of_all(keyed))


def _pruning(
    what: Literal["influences", "keyframes"], a: Skinning, b: Skinning, before: float, after: float
) -> Pruning:
    def count(s: Skinning) -> int:
        if what == "influences":
            return int(np.count_nonzero(s.weights))
        return s.n_frames * s.n_bones if s.keyframes is None else int(np.sum(s.keyframes))

    return Pruning(what, count(a), count(b), size(a).total, size(b).total, before, after)
