"""The command ``garmentnet``: every step from simulation to pictures.

Commands import what they need when they run: ``--help`` is fast, and a command works without the
extras that only others need.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from typing import Any

import typer

from ssdr.cli.streams import safe_streams
from ssdr.errors import (
    FormatError,
    InputError,
    MissingDependencyError,
    SsdrError,
    SsdrWarning,
    error_text,
)
from ssdr.signals import interrupt_on_signals

from .exporting import export
from .importing import import_clips
from .learning import demo, evaluate, predict, train
from .models import models
from .simulating import simulate
from .viewing import view

_CODES: tuple[tuple[Any, int], ...] = (
    ((KeyboardInterrupt, typer.Abort), 130),
    (MissingDependencyError, 4),
    (FormatError, 3),
    (InputError, 2),
    ((SsdrError, OSError, MemoryError), 1),
)

app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Loose garments on a moving body: simulate, learn, predict.",
)


_COMMANDS = (
    simulate, train, evaluate, predict, view, export, demo, models
)  # fmt: skip
for _command in _COMMANDS:
    app.command()(_command)
app.command("import")(import_clips)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code.

    Errors become one line on stderr.  Exit codes: 0 done, 1 unexpected, 2 wrong usage or input, 3
    a file that cannot be read, 4 a missing package, 130 interrupted.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments of the command; by default those of the process.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    with safe_streams(), interrupt_on_signals(), warnings.catch_warnings():
        warnings.showwarning = lambda message, *_: typer.echo(f"warning: {message}", err=True)
        warnings.simplefilter("once", SsdrWarning)
        try:
            code = app(words or ["--help"], prog_name="garmentnet", standalone_mode=False)
            if code == 130:  # what the parser makes of an interrupt
                raise KeyboardInterrupt
            return code if isinstance(code, int) else 0
        except (Exception, KeyboardInterrupt) as error:
            return _report(error)


def _report(error: BaseException) -> int:
    """Say in one line what went wrong, and return the exit code; raise what is unexpected."""
    if hasattr(error, "format_message"):  # of the command line's parser
        context = getattr(error, "ctx", None)
        if context is not None:
            print(context.get_usage(), file=sys.stderr)
        _write_line(f"error: {error.format_message()}")
        return 2
    code = next((code for kinds, code in _CODES if isinstance(error, kinds)), None)
    if code is None:
        raise error
    if code == 130:
        _write_line("stopped; the same command again goes on where it was")
    elif not isinstance(error, BrokenPipeError):  # the reader of stdout has gone
        _write_line(f"error: {error_text(error)}")
    return code


def _write_line(text: str) -> None:
    print(f"garmentnet: {' '.join(text.split())}", file=sys.stderr)
