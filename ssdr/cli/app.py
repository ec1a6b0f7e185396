"""The program ``ssdr``: its commands, its error messages and its exit codes."""

from __future__ import annotations

import contextlib
import errno
import importlib
import json
import logging
import sys
import warnings
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from .. import errors
from ..io.references import trusting
from ..parallel import set_threads
from ..signals import interrupt_on_signals
from .options import Options
from .output import Output
from .streams import safe_streams

_BAD_NAMES = (errno.ENAMETOOLONG, errno.ENOTDIR, errno.ELOOP)
_CODES: tuple[tuple[Any, int], ...] = (
    ((KeyboardInterrupt, errors.Cancelled), 130),
    (errors.MissingDependencyError, 4),
    (errors.FormatError, 3),
    ((errors.InputError, FileNotFoundError, PermissionError, IsADirectoryError), 2),
)

_COMMANDS = ("decompose", "smallest", "info", "compare", "convert", "render", "view")


def _program(given: Sequence[str]) -> typer.Typer:
    """The command-line app, with only the command that the first argument names.

    If the first argument names no command, the app has all of them.
    """
    app = typer.Typer(
        name="ssdr",
        help="Animated meshes to skinned models: rest pose, skin weights and bones.",
        epilog="Exit codes: 0 done, 1 unexpected, 2 wrong usage or input, "
        "3 bad file, 4 missing optional package, 130 interrupted.",
        rich_markup_mode="markdown",
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    for name in given[:1] if given[0] in _COMMANDS else _COMMANDS:
        app.command()(getattr(importlib.import_module(f".{name}", __package__), name))
    return app


def _version(wanted: bool) -> None:
    if wanted:
        from .. import __version__

        typer.echo(f"ssdr {__version__}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
    verbose: Annotated[
        int, typer.Option("--verbose", "-v", count=True, help="Log on stderr; -vv for debugging.")
    ] = 0,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads; all cores by default.")
    ] = None,
) -> None:
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(levelname)s %(name)s: %(message)s"))
    logger = logging.getLogger("ssdr")
    logger.handlers = [handler]
    logger.setLevel((logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)])
    if threads is not None:
        set_threads(threads)


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments of the command; by default those of the process. If there are none, the help is
        shown.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    with safe_streams(), interrupt_on_signals(), warnings.catch_warnings(), trusting(None):
        output = Output.current = Output(Options(json="--json" in given))
        warnings.showwarning = output.warn
        try:
            given = [_sample(word) for word in given] or ["--help"]
            code = _program(given)(given, prog_name="ssdr", standalone_mode=False)
            if code == 130:  # what the parser makes of a KeyboardInterrupt
                return _report(KeyboardInterrupt(), output)
            return code if isinstance(code, int) else 0
        except Exception as error:
            return _report(error, output)


def _sample(word: str) -> str:
    """Path of the sample NAME if a word is ``sample:NAME``; any other word unchanged."""
    if not word.startswith("sample:"):
        return word
    from ..samples import path

    return str(path(word.removeprefix("sample:")))


def _report(error: BaseException, output: Output) -> int:
    """Print an error in one line, and return the exit code."""
    code = _exit_code(error)
    if isinstance(error, BrokenPipeError):  # the reader of stdout has gone
        return code
    as_json = output.options.json and not output.printed
    context = getattr(error, "ctx", None)
    if context is not None and not as_json:
        sys.stderr.write(context.get_usage() + "\n")
    line = " ".join(_message(error).split())
    if as_json:
        document = {"error": line, "kind": type(error).__name__, "exit_code": code}
        with contextlib.suppress(OSError):  # without stdout, stderr gets the error
            output.write(json.dumps({**document, "warnings": output.warnings}) + "\n")
            return code
    sys.stderr.write(f"ssdr: {line}\n" if code == 130 else f"ssdr: error: {line}\n")
    return code


def _exit_code(error: BaseException) -> int:
    """Exit code of an error: 2 to 4 or 130 for expected kinds, 1 for all others."""
    if _is_usage(error) or getattr(error, "errno", None) in _BAD_NAMES:
        return 2
    return next((code for kinds, code in _CODES if isinstance(error, kinds)), 1)


def _message(error: BaseException) -> str:
    """Text of an error for the user."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    if _is_usage(error):
        return str(error.format_message())  # type: ignore[attr-defined]
    if isinstance(error, (errors.SsdrError, OSError, MemoryError)):
        return errors.error_text(error)
    logging.getLogger("ssdr").debug("traceback", exc_info=error)
    return f"unexpected {type(error).__name__}: {error} (ssdr -vv COMMAND shows where)"


def _is_usage(error: BaseException) -> bool:
    """Whether an error comes from the parser of the command line."""
    return hasattr(error, "format_message")
