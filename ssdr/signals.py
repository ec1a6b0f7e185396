"""What the commands of both packages share: signals."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

__all__ = ["handling", "quitting_at_once", "terminate_as_interrupt"]

_HANGUP = getattr(signal, "SIGHUP", None)  # none on Windows


@contextlib.contextmanager
def handling(handler: Callable[[int], None], *names: str) -> Iterator[None]:
    """Have signals call `handler` inside the block, in the main thread.

    Signals that whoever started the process had it ignore (``nohup``, a job in the
    background) stay ignored.  A terminal hangs up on a job once or several times:
    only the first SIGHUP counts.

    Parameters
    ----------
    handler : callable
        Called with the number of the signal.
    names : str
        ``"SIGINT"`` and so on; those that the system has not are left out.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def called(number: int, _: Any) -> None:
        if number == _HANGUP:
            signal.signal(number, signal.SIG_IGN)
        handler(number)

    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    old = {n: signal.getsignal(n) for n in numbers if signal.getsignal(n) != signal.SIG_IGN}
    for number in old:
        signal.signal(number, called)
    try:
        yield
    finally:
        for number, before in old.items():
            hung_up = number == _HANGUP and signal.getsignal(number) == signal.SIG_IGN
            if not hung_up:
                signal.signal(number, before)


def _interrupt(_: int) -> None:
    raise KeyboardInterrupt


def terminate_as_interrupt() -> contextlib.AbstractContextManager[None]:
    """Let SIGTERM and SIGHUP unwind like Ctrl-C, so that no half-written file stays behind."""
    return handling(_interrupt, "SIGTERM", "SIGHUP")


def quitting_at_once(line: str) -> contextlib.AbstractContextManager[None]:
    """End the process at a signal, with a line on stderr: while nothing has been begun.

    An interrupt raised inside an import would be a traceback, or be taken for an error of the
    package that is being imported.
    """

    def quit_(_: int) -> None:
        with contextlib.suppress(OSError):
            os.write(2, line.encode() + b"\n")
        os._exit(130)

    return handling(quit_, "SIGINT", "SIGTERM", "SIGHUP")
