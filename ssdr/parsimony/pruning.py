"""What error a tolerance leaves room for is spent on bytes: fewer influences, fewer keyframes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..sequence import MeshSequence
from ..skinning import Skinning, skin
from ..solver.bone_models import polish_of
from ..solver.model import Fixed, Model
from ..solver.trajectories import Trajectories
from ..streaming.error import squared_error
from .influences import nest
from .keyframes import Tracks
from .report import Measure, Pruning, influence_bytes, size

__all__ = ["Room", "Truth"]

_PRICES, _FEW_PRICES = 12, 3  # of a byte that are tried; where each try walks over all frames
_SETTLE = 6  # polish steps after influences are dropped


class Truth:
    """Errors of models against the frames themselves."""

    def __init__(self, sequences: list[MeshSequence], measure: Measure) -> None:
        self.sequences, self.measure = sequences, measure
        self.count = sum(len(s) for s in sequences) * sequences[0].n_vertices

    def rmse(self, s: Skinning) -> float:
        squared = squared_error(self.sequences, s.rest, s.joints, s.weights, s.transforms)
        return math.sqrt(float(squared.sum()) / self.count)

    def __call__(self, s: Skinning) -> float:
        if self.measure == "rmse":
            return self.rmse(s)
        largest, offset = 0.0, 0
        for sequence in self.sequences:
            for _, block in sequence.chunks():
                part = s.transforms[offset : offset + len(block)]
                gone = skin(s.rest, s.joints, s.weights, part, dtype=np.float64) - block
                largest = max(largest, float(np.einsum("tic,tic->ti", gone, gone).max()))
                offset += len(block)
        return math.sqrt(largest)


class Room:
    """The room between a model's error and the tolerance.

    Parameters
    ----------
    data : Trajectories
    model : Model
        The one that holds, of the frames in `data`.
    tolerance : float
    truth : Truth
        Of all frames.
    offsets : (S + 1,) int array
        First frame of each shot.
    streamed : bool
        Whether `data` holds some of the frames only.
    whole : callable
        A model of `data` as a skinning of all frames.
    told : callable
        Hears of every try.
    """

    def __init__(
        self,
        data: Trajectories,
        model: Model,
        *,
        fixed: Fixed,
        tolerance: float,
        truth: Truth,
        offsets: NDArray[np.int64],
        streamed: bool,
        whole: Callable[[Model], Skinning],
        told: Callable[[], None],
    ) -> None:
        self.data, self.fixed, self.tolerance, self.truth = data, fixed, tolerance, truth
        self.offsets, self.streamed, self.whole, self.told = offsets, streamed, whole, told
        self.nested = nest(data, model, fixed=fixed)

    def use(
        self, whole: Skinning, error: float
    ) -> tuple[Skinning, Skinning, tuple[Pruning, Pruning]]:
        """Fewer influences, then fewer keys as well; both models, and what each cost.

        `error` is that of `whole` over all frames.

        One price of a byte decides on both.  It is guessed from what each choice
        adds by itself, then doubled or halved while models made with it hold.
        """
        best = whole, whole, error, error
        price = self._guess(whole)
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
                if high < 1.2 * low:
                    break
                price = math.sqrt(low * high)
            elif high is None:
                price *= 2.0
            else:
                price *= 0.25 if self.streamed or self.truth.measure == "max" else 0.5
        fewer, keyed, reached, final = best
        losses = (
            _pruning("influences", whole, fewer, error, reached),
            _pruning("keyframes", fewer, keyed, reached, final),
        )
        return fewer, keyed, losses

    def _guess(self, whole: Skinning) -> float:
        """The price of a byte at which what choices add, each by itself, uses up the room."""
        data, nested, unit = self.data, self.nested, self.data.scale**2
        frames = len(whole.transforms)
        room = (self.tolerance**2 - self.truth.rmse(whole) ** 2) * self.truth.count
        before = float(data.importance @ nested.errors[0])
        tracks = Tracks(whole, self.offsets)
        each = influence_bytes(whole.n_bones)

        def added(price: float) -> float:
            chosen = nested.choose(data.importance, price * each / unit)[1]
            # telling frames stand for all
            error = (chosen - before) * unit * frames / data.n_frames
            return error + tracks.choose(price)[1]

        low, high = 1e-12 * room, room
        if not room > 0 or added(low) > room:
            return max(low, 1e-300)
        for _ in range(20):
            middle = math.sqrt(low * high)
            low, high = (middle, high) if added(middle) <= room else (low, middle)
        return low

    def _pruned(self, price: float) -> tuple[Skinning, Skinning, float, float]:
        data, nested = self.data, self.nested
        bones = nested.models[0].n_bones
        each = price * influence_bytes(bones) / data.scale**2
        model = nested.build(nested.choose(data.importance, each)[0])
        if self.truth.measure == "rmse":  # a polish lowers the sum, and may raise the largest
            # a damping handed over: no bone enters, supports stay as they are
            polish = polish_of(data, model, fixed=self.fixed, damping=1e-3)
            for _ in range(_SETTLE):
                polish.step(entering=0)
        self.told()
        fewer = self.whole(model)
        reached = self.truth(fewer)
        if reached > self.tolerance:
            return fewer, fewer, reached, reached
        tracks = Tracks(fewer, self.offsets)
        keyed = tracks.play(tracks.choose(price)[0])
        return fewer, keyed, reached, self.truth(keyed)


def _pruning(
    what: Literal["influences", "keyframes"], a: Skinning, b: Skinning, before: float, after: float
) -> Pruning:
    def count(s: Skinning) -> int:
        if what == "influences":
            return int(np.count_nonzero(s.weights))
        return s.n_frames * s.n_bones if s.keyframes is None else int(np.sum(s.keyframes))

    return Pruning(what, count(a), count(b), size(a).total, size(b).total, before, after)
