"""Live progress on stderr: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Any, TextIO

_EVERY = 5.0  # seconds between plain lines
_PATIENCE = 1.0  # seconds before a wait is worth a line


@contextlib.contextmanager
def waiting(text: str, *, show: bool, stream: TextIO) -> Iterator[None]:
    """Say what is being waited for, and for how long, where the block needs a second or more."""
    if not show or stream.closed:
        yield
        return
    done, live = threading.Event(), stream.isatty()
    began = time.monotonic()

    def tell() -> None:
        pause, told = _PATIENCE, False
        while not done.wait(pause):
            spent = _span(math.floor(time.monotonic() - began))
            with contextlib.suppress(OSError, ValueError):  # a stream that was closed meanwhile
                stream.write(f"\r{text}, {spent}\x1b[K" if live else f"{text}, {spent}\n")
                stream.flush()
            pause, told = (_PATIENCE if live else _EVERY), True
        if told and live:
            with contextlib.suppress(OSError, ValueError):
                stream.write("\r\x1b[K")
                stream.flush()

    teller = threading.Thread(target=tell, name="ssdr-waiting", daemon=True)
    teller.start()
    try:
        yield
    finally:
        done.set()
        teller.join()


class Reporter:
    """Shows what the solver's callback hands over.

    Parameters
    ----------
    show : bool
    stream : text file
    """

    def __init__(self, *, show: bool, stream: TextIO) -> None:
        self._show, self._stream = show, stream
        self._bar: Any = None
        self._task: Any = None
        self._next = 0.0

    def __enter__(self) -> Reporter:
        if self._show and self._stream.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn

            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(bar_width=None),
                TextColumn("{task.percentage:>3.0f} %"),
                TextColumn("{task.fields[text]}"),
                console=Console(file=self._stream),
                transient=True,
                expand=True,
            )
            self._task = self._bar.add_task("preparing", total=1.0, text="")
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def update(self, progress: Any) -> None:
        """Show one step of the solver."""
        if not self._show:
            return
        text = describe(progress)
        if self._bar is not None:
            self._bar.update(
                self._task, completed=progress.fraction, description=progress.phase, text=text
            )
        elif time.monotonic() >= self._next:
            self._next = time.monotonic() + _EVERY
            share = f"{100 * progress.fraction:3.0f} %"
            self._stream.write(f"{share}  {progress.phase}  {text}\n")
            self._stream.flush()


def describe(progress: Any) -> str:
    """Error, time and time left in a few words."""
    parts = []
    if progress.rmse is not None and math.isfinite(progress.rmse):
        parts.append(f"RMSE {progress.rmse:.4g}")
    parts.append(_span(progress.elapsed))
    if progress.time_left is not None and math.isfinite(progress.time_left):
        parts.append(f"{_span(progress.time_left)} left")
    return ", ".join(parts)


def _span(seconds: float) -> str:
    whole = max(0, math.ceil(seconds))
    return f"{whole} s" if whole < 100 else f"{whole // 60} min {whole % 60:02d} s"
