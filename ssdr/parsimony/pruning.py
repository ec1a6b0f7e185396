"""Pruning: influences and keyframes are dropped as far as the tolerance allows.

One multiplier λ, the price of a byte, decides on influences and keyframes: among all ways to store
the weights of a vertex or the keys of a bone, the one of least squared error + λ · bytes is chosen
(Everett 1963).  The search is for the highest price at which the model still holds the tolerance.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model.keyframes import Tracks
from ..model.size import influence_bytes, size
from ..model.skinning import Skinning
from ..search.descent import Descent, Schedule, step
from ..search.moves import drop_influence
from ..search.steps import solve_normals, unfold
from ..solver.gauss_newton import GaussNewton
from ..solver.model import Constraints, Model
from ..solver.trajectories import Trajectories
from .report import Pruning
from .solved_frames import SolvedFrames

# Number of prices to try: enough to come within a fifth of the best price.  For streamed frames,
# where each trial is a pass over all frames, it is just enough to find one at which it holds.
_PRICES, _FEW_PRICES = 12, 3
# Factors to the next price, until one price holds the tolerance and another does not.
_DEARER, _CHEAPER = 2.0, 0.25
# The search ends when a price that misses the tolerance is at most so many times one that holds it.
_CLOSE_PRICES = 1.2
_HALVINGS = 8  # bisections for the first price, from a range of 40 doublings
# Polish steps after influences are dropped, and those with normals of the model that is chosen.
_AFTERWARDS, _WITH_NORMALS = 6, 24
_NEARLY = 0.03  # share of the bytes that better normals and no folds may cost
_SHARES = (1.0, 0.5, 0.25)  # of the price found, at which these are tried
_DAMPING = 1e-3  # initial damping of these steps, as in the solver


class FewerInfluences:
    """Series of models, each with one influence per vertex fewer than the previous one.

    Pruning chooses for each vertex the model that gives it its rest position and weights.

    Parameters
    ----------
    data : Trajectories
    model : Model
    constraints : Constraints

    Attributes
    ----------
    models : list of Model
        Model m has at most K − m influences per vertex.  From one to the next, each vertex loses
        the influence whose removal raises its error least.
    errors : (K, V) float64
        Squared error of each vertex in each model.
    counts : (K, V) int
        Number of influences of each vertex in each model.
    """

    def __init__(self, data: Trajectories, model: Model, constraints: Constraints) -> None:
        self.importance = data.importance
        self.models = [model.copy()]
        while self.models[-1].n_influences > 1:
            fewer = self.models[-1].copy()
            drop_influence(data, fewer, constraints)
            self.models.append(fewer.with_influences(fewer.n_influences - 1))
        self.errors = np.maximum(np.stack([m.error for m in self.models]), 0.0)
        self.counts = np.stack([(m.weights > 0).sum(axis=1) for m in self.models])

    def choose(self, price: float) -> tuple[NDArray[np.intp], float]:
        """Choose the model with least squared error + price · influences, for each vertex.

        Returns
        -------
        (V,) int
            Index in `models` of the chosen model.
        float
            Squared error of all vertices, weighted by importance.
        """
        cost = self.errors * self.importance + price * self.counts
        # the last of equal minima, which has the fewest influences
        level = len(cost) - 1 - cost[::-1].argmin(axis=0)
        least = np.take_along_axis(self.errors, level[None], axis=0)[0]
        return level, float(self.importance @ least)

    def build(self, level: NDArray[np.intp]) -> Model:
        """Model whose vertex v has the rest position and weights that model `level[v]` gives it."""
        out = self.models[0].copy()
        for m, model in enumerate(self.models):
            rows = level == m
            model = model.with_influences(out.n_influences)
            for name in ("rest", "indices", "weights", "error"):
                getattr(out, name)[rows] = getattr(model, name)[rows]
        out.restart_support()
        return out


@step("polish")
def polish_weights(d: Descent, *, polish_steps: int = _AFTERWARDS) -> Iterator[None]:
    """Polish without changing which bones influence a vertex."""
    # given a damping, the polish keeps the supports
    newton = GaussNewton(d.data, d.model, constraints=d.constraints, damping=_DAMPING)
    newton.run(polish_steps, entering=False)
    yield


class Pruned(NamedTuple):
    """A skinning with fewer influences, the same with fewer keys as well, their errors, and bytes.

    The bytes are those of the skinning with fewer keys.
    """

    fewer: Skinning
    keyed: Skinning
    error: float
    keyed_error: float
    bytes: int

    @property
    def largest_error(self) -> float:
        return max(self.error, self.keyed_error)


def prune(
    frames: SolvedFrames,
    model: Model,
    tolerance: float,
    skinning: Skinning,
    skinning_of_all: Callable[[Model, Trajectories], Skinning],
) -> tuple[Skinning, list[Pruning]]:
    """Drop influences and keyframes of a model while its error stays within the tolerance.

    It searches for the largest λ at which the minimum of squared error + λ · bytes still meets the
    tolerance, and returns the smallest model that it found.  At the end normals are solved, too,
    and flipped triangles of the rest pose are unfolded, if the tolerance still holds with at most
    3 % more bytes.

    Parameters
    ----------
    frames : SolvedFrames
    model : Model
        A model that holds the tolerance.
    tolerance : float
    skinning : Skinning
        The same model for all frames.
    skinning_of_all : callable
        Makes a skinning of all frames from a model and the trajectories that it was solved with.

    Returns
    -------
    Skinning
    list of Pruning
        Records of the prunings of influences and of keyframes.
    """
    fewer = FewerInfluences(frames.data, model, frames.problem.constraints)

    def pruned(price: float, schedule: Schedule) -> Pruned:
        return _pruned(frames, fewer, tolerance, price, schedule, skinning_of_all)

    usual, endings = _schedules(frames)
    before = frames.error_of_all(skinning)
    best = Pruned(skinning, skinning, before, before, size(skinning).total)
    price, low, high = _first_price(frames, fewer, tolerance, skinning), None, None
    streamed = frames.scan is not None
    for _ in range(_FEW_PRICES if streamed else _PRICES):
        trial = pruned(price, usual)
        if trial.largest_error > tolerance:
            high = price
        else:
            low = price
            if trial.bytes < best.bytes:
                best = trial
            if streamed:
                break
        if low is None or high is None:
            price *= _CHEAPER if low is None else _DEARER
        elif high < _CLOSE_PRICES * low:
            break
        else:
            price = math.sqrt(low * high)
    for ending, share in itertools.product(endings, _SHARES):
        trial = pruned(share * (low or 0.0), ending)
        if trial.largest_error <= tolerance and trial.bytes <= (1 + _NEARLY) * best.bytes:
            best = trial
            break
    return best.keyed, [
        _record(frames, "influences", skinning, best.fewer, before, best.error),
        _record(frames, "keyframes", best.fewer, best.keyed, best.error, best.keyed_error),
    ]


def _schedules(frames: SolvedFrames) -> tuple[Schedule, list[Schedule]]:
    """Schedule to run after influences are removed, and other schedules to try at the end.

    The latter are tried in turn, until one holds the tolerance with at most slightly more bytes.
    """
    polishes = frames.measure == "rmse"  # a polish may raise the largest error

    def usual(d: Descent) -> None:
        if polishes:
            polish_weights(d)

    def unfolded(d: Descent) -> None:
        usual(d)
        unfold(d, entering=0)

    if not len(frames.data.faces):
        return usual, []
    normals = polishes and frames.problem.normals is not None
    return usual, [_with_normals, unfolded] if normals else [unfolded]


def _with_normals(d: Descent) -> None:
    polish_weights(d)
    solve_normals(d)
    polish_weights(d, polish_steps=_WITH_NORMALS)
    unfold(d, entering=0)


def _first_price(
    frames: SolvedFrames, fewer: FewerInfluences, tolerance: float, skinning: Skinning
) -> float:
    """First price of a byte to try.

    It is the highest price at which the estimated error holds the tolerance.  The estimate is the
    sum of the squared errors that dropping influences and dropping keys would add.
    """
    data = frames.data
    left = tolerance**2 - frames.error_of_all(skinning, "rmse") ** 2
    budget = max(left, 1e-300) * skinning.n_frames * skinning.n_vertices
    tracks = Tracks(skinning, frames.problem.offsets)
    # factor from squared errors in the solver's space to those of all frames in mesh units
    unit = data.alignment.scale**2 * skinning.n_frames / data.n_frames
    influence = influence_bytes(skinning.n_bones) / unit
    least = fewer.choose(0.0)[1]
    low, high = 1e-12 * budget, budget
    for _ in range(_HALVINGS):
        price = math.sqrt(low * high)
        added = (fewer.choose(price * influence)[1] - least) * unit
        holds = added + tracks.choose(price)[1] <= budget
        low, high = (price, high) if holds else (low, price)
    return low


def _pruned(
    frames: SolvedFrames,
    fewer: FewerInfluences,
    tolerance: float,
    price: float,
    schedule: Schedule,
    skinning_of_all: Callable[[Model, Trajectories], Skinning],
) -> Pruned:
    """Remove the influences and keys that are not worth the price, and return a Pruned."""
    influence = influence_bytes(fewer.models[0].n_bones) / frames.data.alignment.scale**2
    model = fewer.build(fewer.choose(price * influence)[0])
    d = frames.descent(model.n_bones)
    d.begin_with(model)
    d.follow(schedule)
    skinning = skinning_of_all(d.best.model, d.data)
    error = frames.error_of_all(skinning)
    if error > tolerance:
        return Pruned(skinning, skinning, error, error, 0)
    tracks = Tracks(skinning, frames.problem.offsets)
    keyed = tracks.play(tracks.choose(price)[0])
    return Pruned(skinning, keyed, error, frames.error_of_all(keyed), size(keyed).total)


def _record(
    frames: SolvedFrames,
    what: Literal["influences", "keyframes"],
    a: Skinning,
    b: Skinning,
    before: float,
    after: float,
) -> Pruning:
    """Record of a pruning from `a` to `b`, whose errors are `before` and `after`."""

    def count(s: Skinning) -> int:
        if what == "influences":
            return int(np.count_nonzero(s.weights))
        return s.n_frames * s.n_bones if s.keyframes is None else int(np.sum(s.keyframes))

    size_a, size_b = (size(s).total for s in (a, b))
    return Pruning(what, count(a), count(b), size_a, size_b, before, after)
