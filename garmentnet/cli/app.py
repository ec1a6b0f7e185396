"""The command ``garmentnet``: every part of the pipeline, from simulation to pictures.

Whatever is heavy is imported where it is used, so that ``--help`` is quick and a part that
needs an extra does not stand in the way of the others.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

import typer

from ssdr.errors import FormatError, InputError, MissingDependencyError, SsdrError
from ssdr.process import error_text, terminate_as_interrupt

from .learning import demo, evaluate, predict, train
from .simulating import dataset, simulate

__all__ = ["app", "main"]

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Loose garments on a moving body: simulate, learn, predict.",
)


for _command in (simulate, dataset, train, evaluate, predict, demo):
    app.command()(_command)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code.

    Errors of this package and of the disk become one line: 2 for an argument, 3 for a file, 4
    for a package that is missing, 1 for the rest, 130 for what was stopped.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process by default.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    with terminate_as_interrupt():
        try:
            code = app(given, prog_name="garmentnet", standalone_mode=False)
            # The parser turns an interrupt into this code and says nothing.
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
            # The reader of stdout has gone; Python would complain again when it exits.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1
        except (SsdrError, OSError, MemoryError) as error:
            return _fail(1, error)
        except Exception as error:
            if not hasattr(error, "format_message"):
                raise
            return _usage(error)


def _stopped() -> int:
    _say("stopped; the same command again goes on where it was")
    return 130


def _fail(code: int, error: BaseException) -> int:
    _say(f"error: {error_text(error)}")
    return code


def _usage(error: Any) -> int:
    # What the parser of the command line raises; the help, where nothing was asked for.
    text, context = error.format_message(), getattr(error, "ctx", None)
    if context is not None and text == context.get_help():
        print(text, file=sys.stderr)
        return 2
    if context is not None:
        print(context.get_usage(), file=sys.stderr)
    _say(f"error: {text}")
    return 2


def _say(text: str) -> None:
    print(f"garmentnet: {' '.join(text.split())}", file=sys.stderr)
