"""Progress reports to a callback, records of accepted models, and the clock of a run."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable

__all__ = ["Callback", "Clock", "Progress", "ProgressReport", "Record"]


@dataclasses.dataclass(frozen=True)
class Record:
    """Record of an accepted model, which has the number of bones and influences asked for.

    Attributes
    ----------
    iteration : int
        Number of alternations and polish steps so far.
    elapsed : float
        Seconds since the call, initialisation included, compilation excluded.
    rmse : float
        sqrt(Σ|d|² / (F V)) over all frames, in the mesh's units.
    phase : str
        Name of the stage that found the model.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> result = ssdr.decompose(dancer, bones=3, effort="fast")
    >>> last = result.history[-1]
    >>> last.iteration >= 1, np.allclose(last.rmse, result.rmse)
    (True, True)
    """

    iteration: int
    elapsed: float
    rmse: float
    phase: str


@dataclasses.dataclass(frozen=True)
class Progress:
    """The state of a run, given to the callback after every step.

    Attributes
    ----------
    phase : str
        Name of the stage.
    iteration : int
        Number of alternations and polish steps so far.
    elapsed : float
        Seconds.
    rmse : float
        Error of the best model so far, in the mesh's units, weighted by the importances if any are
        given; inf before there is a model.  A better model may have a slightly larger error, since
        the rest pose, normals, `smoothness` and joints away from the skin count, too.
    fraction : float
        Estimated fraction of the work that is done, 0 to 1.
    time_left : float
        Estimated seconds until the end.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> fractions = []
    >>> result = ssdr.decompose(
    ...     dancer,
    ...     bones=3,
    ...     effort="fast",
    ...     callback=lambda progress: fractions.append(progress.fraction),
    ... )
    >>> all(0 <= fraction <= 1 for fraction in fractions)
    True
    """

    phase: str
    iteration: int
    elapsed: float
    rmse: float
    fraction: float
    time_left: float


Callback = Callable[[Progress], bool | None]


class Clock:
    """Stopwatch that starts when it is made; `elapsed` is in seconds."""

    def __init__(self) -> None:
        self._began = time.perf_counter()

    @property
    def elapsed(self) -> float:
        return time.perf_counter() - self._began


class ProgressReport:
    """Reporter of steps: builds a :class:`Progress` with the time left, and calls the callback.

    Parameters
    ----------
    callback : callable or None
    clock : Clock
    time_limit : float, optional
        Seconds.
    """

    def __init__(self, callback: Callback | None, clock: Clock, time_limit: float | None = None):
        self.callback, self.clock, self.time_limit = callback, clock, time_limit

    def __call__(self, phase: str, *, iteration: int, rmse: float, fraction: float) -> bool:
        """Report a step; return True if the callback asks to stop."""
        if self.callback is None:
            return False
        elapsed = self.clock.elapsed
        left = elapsed * (1 - fraction) / fraction if fraction > 0 else math.inf
        if self.time_limit is not None:
            left = min(left, max(0.0, self.time_limit - elapsed))
        return bool(self.callback(Progress(phase, iteration, elapsed, rmse, fraction, left)))

    @property
    def out_of_time(self) -> bool:
        return self.time_limit is not None and self.clock.elapsed >= self.time_limit
