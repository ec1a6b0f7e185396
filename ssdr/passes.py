"""The end of a streamed run, alternations over all frames while they pay, and its checkpoints."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .errors import Cancelled, InputError, SsdrWarning
from .model import Model
from .result import Progress
from .run import Run
from .state import SolverState
from .streaming import AllFrames, Told

__all__ = ["PASSES", "Checkpoint", "Passes", "scan_progress", "share_of"]

# share of the work that is done after the scan, the run on telling frames, the one on more
_SCANNED, _FOUND, _SOLVED = 0.05, 0.3, 0.5
PASSES = {"fast": 1, "balanced": 4, "best": 8}  # over all frames, at most
_GAIN = 2e-3  # of the objective, below which another pass is not made
_EVERY = 60.0  # seconds between two checkpoints

Callback = Callable[[Progress], bool | None]


def share_of(settling: bool, settles: bool) -> tuple[float, float]:
    """Share of all the work that is done before and after a run on some frames."""
    if settling:
        return _FOUND, _SOLVED
    return _SCANNED, _FOUND if settles else _SOLVED


def scan_progress(callback: Callback | None, began: float) -> Told | None:
    """Tells a callback how far the scan is; where it asks to stop there is nothing to keep."""
    if callback is None:
        return None

    def told(share: float) -> None:
        elapsed, fraction = time.perf_counter() - began, _SCANNED * share
        stop = callback(
            Progress(
                phase="scan", iteration=0, elapsed=elapsed, rmse=math.inf, fraction=fraction,
                time_left=elapsed * (1 - fraction) / fraction,
            )
        )  # fmt: skip
        if stop:
            raise Cancelled("stopped by the callback before there was any model")

    return told


class Passes:
    """Passes over all frames, and the best model that they found.

    Parameters
    ----------
    frames : AllFrames
    earlier : SolverState, optional
        Of a run that had made some of them already.

    Attributes
    ----------
    best : Model
    records : list of (iteration, elapsed, squared error, phase)
    over : bool
        Whether another pass would not pay.
    """

    def __init__(self, frames: AllFrames, earlier: SolverState | None = None) -> None:
        self.frames, self.over = frames, False
        self.records: list[tuple[int, float, float, str]] = []
        self.best: Model = frames.model
        if earlier is not None and earlier.whole is not None:
            self.records = [(int(r[0]), r[1], r[2], "all frames") for r in earlier.passes]
            self.over = bool(earlier.progress.get("passes_over"))
            self.best = earlier.whole.copy()
            frames.restore(earlier.whole.copy(), len(self.records))

    def progress(self) -> dict[str, Any]:
        return {"passes": [list(r[:3]) for r in self.records], "passes_over": self.over}

    def finish(
        self,
        run: Run,
        effort: str,
        time_limit: float | None,
        callback: Callback | None,
        keep: Callable[[], None] | None,
        *,
        hurried: bool,
    ) -> bool:
        """Passes until they do not pay, one if `hurried`; whether the caller stopped them."""
        count, frames = PASSES[effort], self.frames
        n = len(frames.model.rest)
        scale = frames.alignment.scale / math.sqrt(len(frames.frame_scale) * n)
        stopped = False
        while not (self.over or stopped):
            done = len(self.records)

            def told(share: float, done: int = done) -> None:
                nonlocal stopped
                if callback is None:
                    return
                value = self.records[-1][2] if self.records else math.inf
                fraction = _SOLVED + (1 - _SOLVED) * (done + share) / count
                stopped |= bool(
                    callback(
                        Progress(
                            phase="all frames", iteration=run.iteration + done,
                            elapsed=run.elapsed, rmse=scale * math.sqrt(value),
                            fraction=fraction, time_left=run.here * (1 - fraction) / fraction,
                        )
                    )
                )  # fmt: skip

            value = frames.pass_over(entering=0 if run.smooth else 3, told=told)
            last = self.records[-1][2] if self.records else math.inf
            if value >= last:
                self.over = True
                frames.restore(self.best, done)
                break
            self.records.append((run.iteration + done + 1, run.elapsed, value, "all frames"))
            self.over = value > (1 - _GAIN) * last or done + 1 >= count
            if not self.over:
                self.best = frames.model.copy()
                if keep is not None:
                    keep()
            else:
                self.best = frames.model
            if hurried or (time_limit is not None and run.here >= time_limit):
                break
        return stopped


class Checkpoint:
    """A file that holds the latest state worth keeping."""

    def __init__(self, path: str | Path) -> None:
        if not isinstance(path, (str, Path)):
            raise InputError("checkpoint", "the path of an .npz, or None", type(path).__name__)
        self.path = Path(path)
        if self.path.suffix != ".npz" or not self.path.parent.is_dir():
            raise InputError("checkpoint", "a name ending in .npz in a folder that exists", path)
        self._last = time.monotonic()

    def offer(self, state: Callable[[], SolverState]) -> None:
        """Save a state if the last one is a while ago."""
        if time.monotonic() - self._last >= _EVERY:
            self.save(state())

    def save(self, state: SolverState) -> None:
        """Save a state; a full disk does not end a run that may have taken hours."""
        try:
            state.save(self.path)
        except OSError as error:
            warnings.warn(f"no checkpoint at {self.path}: {error}", SsdrWarning, stacklevel=4)
        self._last = time.monotonic()
