"""What every program of this repository does around its commands: errors, exit codes, streams."""

from __future__ import annotations

import contextlib
import errno
import json
import logging
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from ..common import errors
from ..common.signals import interrupt_on_signals
from .output import Output

_BAD_NAMES = (errno.ENAMETOOLONG, errno.ENOTDIR, errno.ELOOP)
_CODES: tuple[tuple[Any, int], ...] = (
    ((KeyboardInterrupt, errors.Cancelled), 130),
    (errors.MissingDependencyError, 4),
    (errors.FormatError, 3),
    ((errors.InputError, FileNotFoundError, PermissionError, IsADirectoryError), 2),
)


def run_app(
    program: str,
    app: Callable[[], Callable[..., Any]],
    words: Callable[[], Sequence[str]],
    output: Output,
    *,
    interrupted: str = "interrupted",
    raises: bool = False,
) -> int:
    """Run an app of typer and return its exit code; an error becomes a line on stderr.

    Exit codes: 0 done, 1 unexpected, 2 wrong usage or input, 3 a file that cannot be read, 4 a
    missing package, 130 interrupted.

    Parameters
    ----------
    program : str
        Name of the program.
    app, words : callable
        Functions that make the app and the arguments, whose errors are reported as well.
    output : Output
        Where warnings go, and errors as JSON.
    interrupted : str
        What is said after Ctrl-C.
    raises : bool
        Whether an error that is not expected is raised, instead of being reported in a line.
    """
    output.program = program
    with safe_streams(), interrupt_on_signals(), warnings.catch_warnings():
        warnings.showwarning = output.warn
        warnings.simplefilter("default", errors.SsdrWarning)
        try:
            code = app()(list(words()), prog_name=program, standalone_mode=False)
            if code == 130:  # what the parser makes of a KeyboardInterrupt
                raise KeyboardInterrupt
            return code if isinstance(code, int) else 0
        except KeyboardInterrupt as error:
            return _report(error, interrupted, output)
        except Exception as error:
            text = _message(error)
            if raises and not text:
                raise
            if not text:
                logging.getLogger("ssdr").debug("traceback", exc_info=error)
                where = f"({program} -vv COMMAND shows where)"
                text = f"unexpected {type(error).__name__}: {error} {where}"
            return _report(error, text, output)


def _report(error: BaseException, text: str, output: Output) -> int:
    """Print an error and return its exit code."""
    code = _exit_code(error)
    if isinstance(error, BrokenPipeError):  # the reader of stdout has gone
        return code
    as_json = output.json and not output.printed
    context = getattr(error, "ctx", None)
    if context is not None and not as_json:
        sys.stderr.write(context.get_usage() + "\n")
    line = " ".join(text.split())
    if as_json:
        document = {"error": line, "kind": type(error).__name__, "exit_code": code}
        with contextlib.suppress(OSError):  # without stdout, stderr gets the error
            output.write(json.dumps({**document, "warnings": output.warnings}) + "\n")
            return code
    sys.stderr.write(f"{output.program}: {'' if code == 130 else 'error: '}{line}\n")
    return code


def _exit_code(error: BaseException) -> int:
    """Exit code of an error: 2 to 4 or 130 for expected kinds, 1 for all others."""
    if _is_usage(error) or getattr(error, "errno", None) in _BAD_NAMES:
        return 2
    return next((code for kinds, code in _CODES if isinstance(error, kinds)), 1)


def _message(error: BaseException) -> str:
    """Text of an error for the user; empty if it is of no expected kind."""
    if _is_usage(error):
        return str(error.format_message())  # type: ignore[attr-defined]
    if isinstance(error, (errors.SsdrError, OSError, MemoryError)):
        return errors.error_text(error)
    return ""


def _is_usage(error: BaseException) -> bool:
    """Whether an error comes from the parser of the command line."""
    return hasattr(error, "format_message")


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
