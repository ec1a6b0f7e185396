"""The command ``ssdr``: decompose, info, compare, convert, render.

Exit codes: 0 done, 1 something unexpected, 2 wrong usage or input, 3 a file that cannot be
read as what it claims to be, 4 a missing optional package, 130 interrupted.
"""

from __future__ import annotations

import errno
import json
import logging
import sys
import time
import warnings
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from ..errors import (
    Cancelled,
    FormatError,
    InputError,
    MissingDependencyError,
    SsdrError,
    error_text,
)
from ..signals import terminate_as_interrupt
from .comparing import compare
from .converting import convert
from .decomposing import decompose
from .inspecting import info
from .output import Interrupted, Output
from .rendering import render
from .streams import safe_streams
from .timing import seconds_running

__all__ = ["app", "run"]

_BAD_NAMES = (errno.ENAMETOOLONG, errno.ENOTDIR, errno.ELOOP)

app = typer.Typer(
    name="ssdr",
    help="Animated meshes to skinned models: rest pose, skin weights and rigid bones.",
    epilog="Exit codes: 0 done, 1 unexpected, 2 wrong usage or input, 3 bad file, "
    "4 missing optional package, 130 interrupted.",
    no_args_is_help=True,
    add_completion=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _command in (decompose, info, compare, convert, render):
    app.command()(_command)


def _version(wanted: bool) -> None:
    if wanted:
        from .. import __version__

        typer.echo(f"ssdr {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process by default.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    # To whoever typed the command, Python's start and the imports are part of it.
    began = time.perf_counter() - (seconds_running() if arguments is None else 0.0)
    with safe_streams(), terminate_as_interrupt():
        try:
            return _called(given, began)
        except KeyboardInterrupt:  # a second one, while the first was being dealt with
            return 130


def _called(given: list[str], began: float) -> int:
    as_json = "--json" in given
    output = Output.current = Output(arguments=given, began=began)
    with warnings.catch_warnings():
        warnings.showwarning = output.warn
        try:
            code = app(given, prog_name="ssdr", standalone_mode=False)
            if code == 130:  # what the parser makes of an interrupt
                raise KeyboardInterrupt
            return code if isinstance(code, int) else 0
        except (KeyboardInterrupt, Interrupted, Cancelled) as error:
            return _fail(130, error, str(error) or "interrupted", as_json)
        except MissingDependencyError as error:
            return _fail(4, error, str(error), as_json)
        except FormatError as error:
            return _fail(3, error, str(error), as_json)
        except (InputError, FileNotFoundError, PermissionError, IsADirectoryError) as error:
            return _fail(2, error, error_text(error), as_json)
        except BrokenPipeError:  # the reader of stdout has gone
            return 1
        except (SsdrError, OSError, MemoryError) as error:
            code = 2 if getattr(error, "errno", None) in _BAD_NAMES else 1
            return _fail(code, error, error_text(error), as_json)
        except Exception as error:
            if hasattr(error, "format_message"):  # what the parser of the command line raises
                return _fail(2, error, error.format_message(), as_json, usage=error)
            logging.getLogger("ssdr").debug("traceback", exc_info=True)
            text = f"unexpected {type(error).__name__}: {error} (-vv shows where)"
            return _fail(1, error, text, as_json)


def _fail(
    code: int, error: BaseException, text: str, as_json: bool, usage: Any | None = None
) -> int:
    output = Output.current
    if usage is not None and getattr(usage, "ctx", None) is not None and not as_json:
        if text == usage.ctx.get_help():  # nothing was asked for
            sys.stderr.write(text + "\n")
            return code
        sys.stderr.write(usage.ctx.get_usage() + "\n")
    line = " ".join(text.split())
    if as_json:
        document: dict[str, Any] = {
            "error": line,
            "kind": type(error).__name__,
            "exit_code": code,
            "warnings": output.warnings,
            **getattr(error, "details", {}),
        }
        try:
            sys.stdout.write(json.dumps(document) + "\n")
            sys.stdout.flush()
            return code
        except OSError:
            pass  # stderr is what is left
    sys.stderr.write(f"ssdr: {line}\n" if code == 130 else f"ssdr: error: {line}\n")
    return code
