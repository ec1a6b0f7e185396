"""Progress of a command on stderr, with the bar of the command ``ssdr``."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from ssdr.cli.progress import progress_bar as bar
from ssdr.cli.progress import times_text

__all__ = ["Show", "progress_bar"]

# Called with what is being done, the fraction that is done and the seconds left, if known.
Show = Callable[[str, float, float | None], None]
_EVERY = 5.0  # seconds between lines


@contextlib.contextmanager
def progress_bar() -> Iterator[Show]:
    """A bar on a terminal, a line every few seconds elsewhere; yields what updates it."""
    began = time.monotonic()
    with bar() if sys.stderr.isatty() else contextlib.nullcontext(_print_seldom()) as show:
        yield lambda text, fraction, left: show(
            text, fraction, times_text(time.monotonic() - began, left)
        )


def _print_seldom() -> Callable[[str, float, str], None]:
    last = -_EVERY

    def show(phase: str, fraction: float, text: str) -> None:
        nonlocal last
        if time.monotonic() - last >= _EVERY:
            last = time.monotonic()
            print(f"{100 * fraction:3.0f} %  {phase}  {text}", file=sys.stderr, flush=True)

    return show
