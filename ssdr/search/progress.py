"""What a callback gets after every step, what the history keeps, and the clock behind both."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable

__all__ = ["Callback", "Clock", "Progress", "Record", "Reporter"]


@dataclasses.dataclass(frozen=True)
class Record:
    """One accepted model of exactly the bones and influences asked for.

    Attributes
    ----------
    iteration : int
        Alternations and polish steps so far.
    elapsed : float
        Seconds since the call, initialisation included, compilation not.
    rmse : float
        sqrt(Σ|d|² / (F V)) over all frames, in the mesh's units.
    phase : str
        The step that found it.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> result = ssdr.decompose(dancer, bones=3, effort="fast", max_iterations=1)
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
    """What a callback gets after every step.

    Attributes
    ----------
    phase : str
    iteration : int
    elapsed : float
        Seconds.
    rmse : float
        Of the best model so far, in the mesh's units; inf before there is one.
        Weighted by the importances, where there are any.
    fraction : float
        Estimated fraction of the work that is done, 0 to 1.
    time_left : float
        Estimate in seconds.

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> fractions = []
    >>> result = ssdr.decompose(
    ...     dancer,
    ...     bones=3,
    ...     effort="fast",
    ...     max_iterations=1,
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
    """Seconds of a call, and of the calls that it resumes.

    Attributes
    ----------
    before : float
        Seconds of the calls before this one.
    """

    def __init__(self) -> None:
        self._began = time.perf_counter()
        self.before = 0.0

    @property
    def here(self) -> float:
        """Seconds since this call began."""
        return time.perf_counter() - self._began

    @property
    def elapsed(self) -> float:
        """Seconds of all the calls."""
        return self.before + self.here


class Reporter:
    """The one place that builds a :class:`Progress`, time left included, and calls the callback.

    Parameters
    ----------
    callback : callable or None
    clock : Clock
    time_limit : float, optional
        Seconds of this call.
    """

    def __init__(self, callback: Callback | None, clock: Clock, time_limit: float | None = None):
        self.callback, self.clock, self.time_limit = callback, clock, time_limit

    def __call__(self, phase: str, *, iteration: int, rmse: float, fraction: float) -> bool:
        """Report a step; whether the callback asks to stop."""
        if self.callback is None:
            return False
        elapsed = self.clock.elapsed
        left = elapsed * (1 - fraction) / fraction if fraction > 0 else math.inf
        if self.time_limit is not None:
            left = min(left, max(0.0, self.time_limit - self.clock.here))
        progress = Progress(
            phase=phase,
            iteration=iteration,
            elapsed=elapsed,
            rmse=rmse,
            fraction=fraction,
            time_left=left,
        )
        return bool(self.callback(progress))

    @property
    def out_of_time(self) -> bool:
        return self.time_limit is not None and self.clock.here >= self.time_limit
