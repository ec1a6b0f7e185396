"""The error that a tolerance leaves is spent on bytes: fewer influences, fewer keyframes.

Both are choices of error against bytes, made with one multiplier λ, the price of a byte: of all
ways to store a vertex's weights, or a bone's keys, the one of least error + λ · bytes (Everett
1963).  The price is raised while the models that it leads to hold the tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..drivers.problem import Measure
from ..frames.error import largest_error, squared_error
from ..frames.executor import Executor
from ..sequence import MeshSequence
from ..skinning import Skinning
from ..solver.gauss_newton import GaussNewton
from ..solver.model import Fixed, Model
from ..solver.trajectories import Trajectories
from .influences import nest
from .keyframes import Tracks
from .report import Pruning, influence_bytes, size

__all__ = ["ErrorBudget", "TrueError"]

# Prices of a byte that are tried: enough to come within a fifth of the best one; where each try
# walks over all frames, as few as bracket it.
_PRICES, _FEW_PRICES = 12, 3
_CLOSE_PRICES = 1.2  # ratio of the prices on either side of the best at which the search ends
_SETTLE = 6  # polish steps after influences are dropped
_DAMPING = 1e-3  # of that polish: where it starts in the solver, too


class TrueError:
    """Errors of skinnings against the frames themselves.

    Parameters
    ----------
    sequences : list of MeshSequence
    measure : {"rmse", "max"}
    executor : Executor, optional
        Walks over the frames; this process by default.
    """

    def __init__(
        self,
        sequences: list[MeshSequence],
        measure: Measure,
        executor: Executor | None = None,
    ) -> None:
        self.sequences, self.measure, self.executor = sequences, measure, executor
        self.count = sum(len(s) for s in sequences) * sequences[0].n_vertices

    def rmse(self, s: Skinning) -> float:
        squared = squared_error(
            self.sequences, s.rest, s.indices, s.weights, s.transforms, executor=self.executor
        )
        return math.sqrt(float(squared.sum()) / self.count)

    def __call__(self, s: Skinning) -> float:
        """The error that is asked about."""
        if self.measure == "rmse":
            return self.rmse(s)
        return largest_error(
            self.sequences, s.rest, s.indices, s.weights, s.transforms, executor=self.executor
        )


class ErrorBudget:
    """What lies between a model's error and the tolerance.

    Parameters
    ----------
    data : Trajectories
    model : Model
        The one that holds the tolerance, of the frames in `data`.
    tolerance : float
    true_error : TrueError
        Over all frames.
    offsets : (S + 1,) int array
        First frame of each shot.
    streamed : bool
        Whether `data` holds some of the frames only.
    to_skinning : callable
        A model of `data` as a skinning of all frames.
    on_try : callable
        Called after every try.
    """

    def __init__(
        self,
        data: Trajectories,
        model: Model,
        *,
        fixed: Fixed,
        tolerance: float,
        true_error: TrueError,
        offsets: NDArray[np.int64],
        streamed: bool,
        to_skinning: Callable[[Model], Skinning],
        on_try: Callable[[], None],
    ) -> None:
        self.data, self.fixed, self.tolerance = data, fixed, tolerance
        self.true_error, self.offsets, self.streamed = true_error, offsets, streamed
        self.to_skinning, self.on_try = to_skinning, on_try
        self.nested = nest(data, model, fixed=fixed)

    def spend(
        self, skinning: Skinning, error: float
    ) -> tuple[Skinning, Skinning, tuple[Pruning, Pruning]]:
        """Fewer influences, then fewer keys as well; both models, and what each cost.

        `error` is that of `skinning` over all frames.

        One price of a byte decides on both.  It is guessed from what each choice
        adds by itself, then doubled or halved while models made with it hold.
        """
        best = skinning, skinning, error, error
        price = self._guess(skinning)
        low = high = None
        for _ in range(_FEW_PRICES if self.streamed else _PRICES):
            trial = self._pruned(price)
            if trial[3] <= self.tolerance and trial[2] <= self.tolerance:
                low = price
                if size(trial[1]).total < size(best[1]).total:
                    best = trial
                if self.streamed:
                    break
            else:
                high = price
            if low is not None and high is not None:
                if high < _CLOSE_PRICES * low:
                    break
                price = math.sqrt(low * high)
            elif high is None:
                price *= 2.0
            else:
                price *= 0.25 if self.streamed or self.true_error.measure == "max" else 0.5
        fewer, keyed, reached, final = best
        losses = (
            _pruning("influences", skinning, fewer, error, reached),
            _pruning("keyframes", fewer, keyed, reached, final),
        )
        return fewer, keyed, losses

    def _guess(self, skinning: Skinning) -> float:
        """The price of a byte at which what choices add, each by itself, uses up the budget."""
        data, nested, unit = self.data, self.nested, self.data.scale**2
        frames = len(skinning.transforms)
        budget = self.tolerance**2 - self.true_error.rmse(skinning) ** 2
        budget *= self.true_error.count
        before = float(data.importance @ nested.errors[0])
        tracks = Tracks(skinning, self.offsets)
        each = influence_bytes(skinning.n_bones)

        def added(price: float) -> float:
            chosen = nested.choose(data.importance, price * each / unit)[1]
            # representative frames stand for all
            error = (chosen - before) * unit * frames / data.n_frames
            return error + tracks.choose(price)[1]

        low, high = 1e-12 * budget, budget
        if not budget > 0 or added(low) > budget:
            return max(low, 1e-300)
        for _ in range(20):
            middle = math.sqrt(low * high)
            low, high = (middle, high) if added(middle) <= budget else (low, middle)
        return low

    def _pruned(self, price: float) -> tuple[Skinning, Skinning, float, float]:
        data, nested = self.data, self.nested
        bones = nested.models[0].n_bones
        each = price * influence_bytes(bones) / data.scale**2
        model = nested.build(nested.choose(data.importance, each)[0])
        if self.true_error.measure == "rmse":  # a polish lowers the sum, and may raise the largest
            # a damping handed over: no bone enters, supports stay as they are
            polish = GaussNewton(data, model, fixed=self.fixed, damping=_DAMPING)
            for _ in range(_SETTLE):
                polish.step(entering=0)
        self.on_try()
        fewer = self.to_skinning(model)
        reached = self.true_error(fewer)
        if reached > self.tolerance:
            return fewer, fewer, reached, reached
        tracks = Tracks(fewer, self.offsets)
        keyed = tracks.play(tracks.choose(price)[0])
        return fewer, keyed, reached, self.true_error(keyed)


def _pruning(
    what: Literal["influences", "keyframes"], a: Skinning, b: Skinning, before: float, after: float
) -> Pruning:
    def count(s: Skinning) -> int:
        if what == "influences":
            return int(np.count_nonzero(s.weights))
        return s.n_frames * s.n_bones if s.keyframes is None else int(np.sum(s.keyframes))

    return Pruning(what, count(a), count(b), size(a).total, size(b).total, before, after)
