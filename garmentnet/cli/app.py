"""The command ``garmentnet``: every step from simulation to pictures.

Commands import what they need when they run: ``--help`` is fast, and a command works without the
extras that only others need.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

import typer

from ssdr.cli.streams import safe_streams
from ssdr.errors import FormatError, InputError, MissingDependencyError, SsdrError, error_text
from ssdr.signals import interrupt_on_signals

from .exporting import export
from .importing import import_clips
from .learning import demo, evaluate, predict, reproduce, train
from .models import models
from .simulating import dataset, simulate
from .viewing import view

__all__ = ["app", "main"]

app = typer.Typer(
    add_completion=True,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Loose garments on a moving body: simulate, learn, predict.",
)


_COMMANDS = (
    simulate, dataset, train, evaluate, predict, view, export, reproduce, demo, models
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
        Those of the process by default.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    with safe_streams(), interrupt_on_signals():
        try:
            code = app(words, prog_name="garmentnet", standalone_mode=False)
            # The parser turns an interrupt into this code, without a message.
            return _stopped() if code == 130 else code if isinstance(code, int) else 0
        except (KeyboardInterrupt, typer.Abort):
            return _stopped()
        except MissingDependencyError as error:
            return _fail(4, error)
        except FormatError as error:
            return _fail(3, error)
        except InputError as error:
            return _fail(2, error)
        except BrokenPipeError:
            # The reader of stdout has closed it; Python would fail again when it exits.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1
        except (SsdrError, OSError, MemoryError) as error:
            return _fail(1, error)
        except Exception as error:
            if not hasattr(error, "format_message"):
                raise
            return _usage(error)


def _stopped() -> int:
    _write_line("stopped; the same command again goes on where it was")
    return 130


def _fail(code: int, error: BaseException) -> int:
    _write_line(f"error: {error_text(error)}")
    return code


def _usage(error: Any) -> int:
    # Errors of the command line's parser; without arguments it raises the help.
    text, context = error.format_message(), getattr(error, "ctx", None)
    if context is not None and text == context.get_help():
        print(text, file=sys.stderr)
        return 2
    if context is not None:
        print(context.get_usage(), file=sys.stderr)
    _write_line(f"error: {text}")
    return 2


def _write_line(text: str) -> None:
    print(f"garmentnet: {' '.join(text.split())}", file=sys.stderr)
