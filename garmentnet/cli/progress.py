"""How far a command is, on stderr: the bar of the command ``ssdr``."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import sys
import time
from collections.abc import Callable, Iterator

from ssdr.cli.progress import Reporter

__all__ = ["Show", "progress_bar"]

# Called with what is being done, the fraction that is done and the seconds left, if known.
Show = Callable[[str, float, float | None], None]


@dataclasses.dataclass(frozen=True)
class _Step:
    """What the reporter looks at."""

    phase: str
    fraction: float
    elapsed: float
    time_left: float
    rmse: float | None = None


@contextlib.contextmanager
def progress_bar() -> Iterator[Show]:
    """A bar on a terminal, a line every few seconds elsewhere; yields what updates it."""
    began = time.monotonic()
    with Reporter(show=True, stream=sys.stderr) as reporter:

        def show(text: str, fraction: float, time_left: float | None) -> None:
            left = math.nan if time_left is None else time_left
            reporter.update(_Step(text, fraction, time.monotonic() - began, left))

        yield show
