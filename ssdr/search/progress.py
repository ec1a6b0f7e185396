"""Progress of a run: what its callback is told, its clock and time limit, checkpoints, records."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import math
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ..common.errors import Cancelled, InputError, SsdrError, SsdrWarning
from ..model.skinning import Skinning

_SECONDS = 60.0  # between two checkpoints, and so the most that a killed process loses

_logger = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Record:
    """Record of an accepted model, which has the requested numbers of bones and influences.

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
    >>> result = ssdr.decompose(dancer, bones=4, effort="fast")
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
    ...     bones=4,
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


class Stop(Exception):
    """End of a run before all its steps are made; the argument is the reason."""


class Monitor:
    """Clock of a run, which reports every step to the callback and ends the run on request.

    Parameters
    ----------
    callback : callable, optional
    time_limit : float, optional
        Seconds.
    checkpoint : str or Path, optional
        File ``.npz`` for the best model so far, which is never left half written.

    Attributes
    ----------
    stopped : str or None
        Why the run ends early, "cancelled" or "time limit", or None.  Once this is set, the
        callback is not called any more.
    began : float
        When the clock was at 0, as :func:`time.perf_counter` counts.

    Raises
    ------
    InputError
        If the name of the checkpoint does not end in ``.npz`` or its folder does not exist.
    """

    def __init__(
        self,
        callback: Callback | None = None,
        *,
        time_limit: float | None = None,
        checkpoint: Any = None,
    ) -> None:
        self.callback, self.time_limit = callback, time_limit
        self.checkpoint: Path | None = None
        if checkpoint is not None:
            if not isinstance(checkpoint, (str, Path)):
                came = type(checkpoint).__name__
                raise InputError("checkpoint", "the path of an .npz, or None", came)
            self.checkpoint = file = Path(checkpoint)
            if file.suffix != ".npz" or not file.parent.is_dir() or file.is_dir():
                wanted = "a name ending in .npz in a folder that exists"
                raise InputError("checkpoint", wanted, checkpoint)
        self.stopped: str | None = None
        self._part = 0.0, 1.0
        self.began, self._written = time.perf_counter(), time.monotonic()

    @property
    def elapsed(self) -> float:
        """Seconds since this object was made."""
        return time.perf_counter() - self.began

    @property
    def out_of_time(self) -> bool:
        return self.time_limit is not None and self.elapsed >= self.time_limit

    @contextlib.contextmanager
    def part(self, first: float, last: float) -> Iterator[None]:
        """Context in which reported fractions 0 to 1 mean `first` to `last` of the work."""
        a, b = before = self._part
        self._part = a + (b - a) * first, a + (b - a) * last
        try:
            yield
        finally:
            self._part = before

    def report(
        self, phase: str, *, iteration: int, rmse: float, fraction: float, ready: bool = True
    ) -> None:
        """Tell the callback of a step; `ready` says whether there is a model to return.

        Raises
        ------
        Stop
            If the callback asks to stop or time is up, and there is a model.
        Cancelled
            If the callback asks to stop before there is one.
        """
        a, b = self._part
        fraction = a + (b - a) * fraction
        said = phase, iteration, rmse, 100 * fraction
        _logger.debug("%s, iteration %d, rmse %.6g, %.0f %% done", *said)
        if self.stopped is None:
            elapsed = self.elapsed
            left = elapsed * (1 - fraction) / fraction if fraction > 0 else math.inf
            if self.time_limit is not None:
                left = min(left, max(0.0, self.time_limit - elapsed))
            told = Progress(phase, iteration, elapsed, rmse, fraction, left)
            if self.callback is not None and self.callback(told):
                self.stopped = "cancelled"
            elif ready and self.out_of_time:
                self.stopped = "time limit"
        if self.stopped is not None and not ready:
            raise Cancelled("stopped by the callback before there was a result")
        self.raise_if_stopped()

    def raise_if_stopped(self) -> None:
        """Raise Stop if a report has asked for the end of the run."""
        if self.stopped is not None:
            raise Stop(self.stopped)

    def offer(self, skinning: Callable[[], Skinning], *, now: bool = False) -> None:
        """Write the model that `skinning` returns, at most once a minute unless `now` is set.

        If the write fails, as on a full disk, a warning is issued, so that a run of hours goes on.
        """
        if self.checkpoint is None or (not now and time.monotonic() - self._written < _SECONDS):
            return
        from ..io.arrays.npz import write_skinning

        try:
            write_skinning(skinning(), self.checkpoint, compress=False)
        except (OSError, SsdrError) as error:
            message = f"no checkpoint at {self.checkpoint}: {error}"
            warnings.warn(message, SsdrWarning, stacklevel=2)
        self._written = time.monotonic()
