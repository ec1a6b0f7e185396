"""Progress of a command on stderr, with the bar of the command ``ssdr``."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from ssdr.cli import progress

__all__ = ["Show", "progress_bar"]

# Called with what is being done, the fraction that is done and the seconds left, if known.
Show = Callable[[str, float, float | None], None]
_EVERY = 5.0  # seconds between lines


@contextlib.contextmanager
def progress_bar() -> Iterator[Show]:
    """A bar on a terminal, a line every few seconds elsewhere; yields what updates it."""
    if not sys.stderr.isatty():
        yield _seldom()
        return
    with progress.progress_bar() as show:
        yield lambda text, fraction, _: show(text, fraction, "")


def _seldom() -> Show:
    """Print a line, but not more often than every few seconds."""
    began = time.monotonic()
    last = began - _EVERY

    def show(text: str, fraction: float, left: float | None) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= _EVERY:
            last = now
            times = f"{now - began:.0f} s" + ("" if left is None else f", {left:.0f} s left")
            print(f"{100 * fraction:3.0f} %  {text}  {times}", file=sys.stderr, flush=True)

    return show
