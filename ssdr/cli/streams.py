"""Standard streams that do not stop the work if they cannot be written."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def safe_streams() -> Iterator[None]:
    """Keep the work inside the block going if a message cannot be written.

    A character that the encoding of a stream lacks is written as an escape sequence. What stderr
    cannot take is dropped; an error of stdout, which holds results, is raised where it is written.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, ValueError):
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    stderr = sys.stderr
    sys.stderr = _Messages(stderr)
    try:
        yield
    finally:
        sys.stderr = stderr
        try:
            sys.stdout.flush()
        except OSError:
            # What is left in the buffer would fail once more when Python exits.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class _Messages:
    """Stream that drops text which it cannot write."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError, ValueError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            self._stream.flush()
