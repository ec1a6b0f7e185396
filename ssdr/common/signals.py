"""Response to Ctrl-C (SIGINT), to SIGTERM and to a closed terminal (SIGHUP).

1. While modules are imported, Ctrl-C ends the process (:func:`ssdr.cli.main`); while a package of
   native code is, at the end of that (:func:`interrupted_after`).
2. While inputs are read, and in commands that solve nothing, the signal is raised as
   ``KeyboardInterrupt``, so that temporary files are removed (:func:`interrupt_on_signals`).
3. While a model is solved and saved, the first signal asks the solver to stop after its current
   step, and the best model so far is written to the outputs.  A second signal ends the process
   at once (:func:`stop_on_signals`; :func:`ssdr.io.save_all` writes the model).

Python handles a signal only between its own instructions, so long-running native code delays it.
A watcher thread therefore ends the process one second after the second signal, if the block has
not ended.

The exit code is 130 each time.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

_SHOW_CURSOR = b"\x1b[?25h\n"  # the progress bar hides it
_HANGUP = getattr(signal, "SIGHUP", None)  # none on Windows
_GRACE = 1.0  # seconds for removing temporary files after the second signal


def interrupt_on_signals() -> contextlib.AbstractContextManager[None]:
    """Context in which a signal raises ``KeyboardInterrupt``."""

    def interrupt() -> None:
        raise KeyboardInterrupt

    return _handling(interrupt)


@contextlib.contextmanager
def interrupted_after() -> Iterator[None]:
    """Context in which Ctrl-C waits for the end of the block, as native code may swallow it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came:
            signal.raise_signal(signal.SIGINT)


@contextlib.contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """Context with an event that the first Ctrl-C sets; the second one ends the process.

    A callback that returns whether it is set ends a solve with the best model so far. SIGTERM and
    a closed terminal count as Ctrl-C.

    Yields
    ------
    threading.Event

    Examples
    --------
    >>> dancer = ssdr.samples.load("dancer_small")
    >>> with ssdr.stop_on_signals() as stop:
    ...     result = ssdr.decompose(
    ...         dancer, bones=4, effort="fast", callback=lambda progress: stop.is_set()
    ...     )
    >>> result.stop_reason != "cancelled"
    True
    """
    stop = threading.Event()

    def ask() -> None:
        if stop.is_set():
            _end()
        stop.set()
        _write_stderr(b"\nssdr: stopping after this step and saving; again to end at once\n")

    with _handling(ask):
        yield stop


def _end(message: bytes = b"") -> None:
    """End the process at once with exit code 130, without any cleanup."""
    _write_stderr((_SHOW_CURSOR if sys.stderr.isatty() else b"") + message)
    os._exit(130)


def _write_stderr(text: bytes) -> None:
    """Write to stderr without a buffer, since a signal may interrupt a buffered write."""
    with contextlib.suppress(OSError):  # a terminal that has been closed
        os.write(2, text)


@contextlib.contextmanager
def _handling(handler: Callable[[], None]) -> Iterator[None]:
    """Call `handler` at a signal inside the block, in the main thread.

    Signals that are ignored from the start, as under ``nohup``, stay ignored.  A terminal that
    is closed may send SIGHUP several times; only the first one counts.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def called(number: int, _: Any) -> None:
        if number == _HANGUP:
            signal.signal(number, signal.SIG_IGN)
        handler()

    numbers = [n for n in (signal.SIGINT, signal.SIGTERM, _HANGUP) if n is not None]
    before = {n: signal.getsignal(n) for n in numbers if signal.getsignal(n) != signal.SIG_IGN}
    for number in before:
        signal.signal(number, called)
    try:
        with _counted(frozenset(before)):
            yield
    finally:
        for number, old in before.items():
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, old)


@contextlib.contextmanager
def _counted(numbers: frozenset[int]) -> Iterator[None]:
    """End the process soon after the second of these signals inside the block.

    The interpreter writes the number of each signal to a socket as it arrives, even while native
    code runs.  If another socket is in use already, as inside another such block, nothing is done.
    """
    before = signal.set_wakeup_fd(-1)
    if before != -1:
        signal.set_wakeup_fd(before)
        yield
        return
    received, sent = socket.socketpair()
    ended = threading.Event()

    def count() -> None:
        seen: list[int] = []
        while len(seen) < 2:
            data = received.recv(1)
            if not data:  # the block has ended
                return
            seen += [n for n in data if n in numbers and not (n == _HANGUP and n in seen)]
        if not ended.wait(_GRACE):
            _end(b"\nssdr: interrupted\n")

    thread = threading.Thread(target=count, daemon=True)
    with received, sent:
        sent.setblocking(False)
        thread.start()
        signal.set_wakeup_fd(sent.fileno(), warn_on_full_buffer=False)
        try:
            yield
        finally:
            signal.set_wakeup_fd(-1)
            ended.set()
            sent.close()
            thread.join()
