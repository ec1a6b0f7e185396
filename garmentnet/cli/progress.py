"""Progress of a command on standard error: a bar on a terminal, lines of text elsewhere."""

from __future__ import annotations

import contextlib
import logging
import sys
import time
from collections.abc import Iterator

from ssdr.cli import output

from ..io.files import Progress

_EVERY = 5.0  # seconds between lines


def log() -> None:
    """Write the log's lines, from the level INFO on, to stderr."""
    logger = logging.getLogger("garmentnet")
    logger.handlers = [logging.StreamHandler(sys.stderr)]
    logger.setLevel(logging.INFO)


@contextlib.contextmanager
def progress_bar() -> Iterator[Progress]:
    """Context with a function that shows progress: as a bar on a terminal, otherwise as lines."""
    if not sys.stderr.isatty():
        yield _seldom()
        return
    with output.progress_bar() as show:
        yield lambda text, fraction: show(text, fraction, "")


def _seldom() -> Progress:
    """Function that prints a line of progress, at most every few seconds."""
    began = time.monotonic()
    last = began - _EVERY

    def show(text: str, fraction: float) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= _EVERY:
            last = now
            line = f"{100 * fraction:3.0f} %  {text}  {now - began:.0f} s"
            print(line, file=sys.stderr, flush=True)

    return show
