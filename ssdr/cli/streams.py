"""Standard streams that are closed, full or of few characters: none of them ends the work."""

from __future__ import annotations

import codecs
import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any

__all__ = ["safe_streams"]

_INSTEAD = {"√": "sqrt", "×": "x", "·": "*", "–": "-", "…": "..."}
_HANDLER = "ssdr.plain"


@contextlib.contextmanager
def safe_streams() -> Iterator[None]:
    """Have stdout and stderr take any text inside the block.

    A character that the encoding lacks is spelled in others.  A stream that is closed takes
    everything and drops it.  Stderr drops what it cannot write; stdout holds results, and
    an error of it names it.
    """
    _fill_descriptors()
    codecs.register_error(_HANDLER, _plain)
    old = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _Results(_spelling(old[0])), _Messages(_spelling(old[1]))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = old


def _fill_descriptors() -> None:
    """Let no file that is opened later get the number of a closed standard stream."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            with contextlib.suppress(OSError):
                os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free


def _spelling(stream: Any) -> Any:
    if stream is None:  # closed when Python started
        return open(os.devnull, "w", encoding="utf-8")
    with contextlib.suppress(AttributeError, ValueError, OSError):
        stream.reconfigure(errors=_HANDLER)
    return stream


def _plain(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    escaped = "".join(
        _INSTEAD.get(c) or c.encode("ascii", "backslashreplace").decode() for c in text
    )
    return escaped, error.end


class _Wrapped:
    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class _Messages(_Wrapped):
    """Progress, warnings and errors: what cannot be said is no reason to fail."""

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError, ValueError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            self._stream.flush()


class _Results(_Wrapped):
    """The result: an error says which file it is about, and comes again at whatever follows."""

    _error: OSError | None = None

    def write(self, text: str) -> int:
        with self._named():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with self._named():
            self._stream.flush()

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        if self._error is not None:
            raise self._error
        try:
            yield
        except OSError as error:
            # What is left in the buffer would fail once more when Python exits.
            with contextlib.suppress(AttributeError, ValueError, OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
            self._error = OSError(error.errno, error.strerror, "standard output")
            raise self._error from error
