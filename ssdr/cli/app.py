"""The program ``ssdr``: its commands, its error messages and its exit codes."""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from ..common.parallel import set_threads
from ..io.references import trusting
from . import file_commands, show_commands, solve_commands
from .output import Output
from .parameters import command
from .shell import run_app


class _Command(TyperCommand):
    """A command whose help does not name the type of ``--help``, as it does of no other flag."""

    def get_help_option(self, ctx: Any) -> Any:
        option = super().get_help_option(ctx)
        if option is not None:
            option.metavar = " "
        return option


_COMMANDS = {
    "decompose": solve_commands.decompose,
    "smallest": solve_commands.smallest,
    "info": file_commands.info,
    "compare": file_commands.compare,
    "convert": file_commands.convert,
    "render": show_commands.render,
    "view": show_commands.view,
}


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
    output = Output.current = Output(json="--json" in given)
    with trusting(None):
        return run_app("ssdr", lambda: _program(given), lambda: _words(given), output)


def _program(given: Sequence[str]) -> typer.Typer:
    """The app, with only the command that the first argument names, or with all of them."""
    app = typer.Typer(
        help="Animated meshes to skinned models: rest pose, skin weights and bones.",
        epilog="Exit codes: 0 done, 1 unexpected, 2 wrong usage or input, 3 bad file, "
        "4 missing optional package, 130 interrupted.",
        rich_markup_mode="markdown",
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    named = [name for name in given[:1] if name in _COMMANDS]
    for name in named or _COMMANDS:
        app.command(name, cls=_Command)(command(_COMMANDS[name]))
    return app


def _words(given: Sequence[str]) -> list[str]:
    """Arguments in which ``sample:NAME`` is the path of that sample; without any, ``--help``."""
    from ..io.samples import path

    name = "sample:"
    return [str(path(w.removeprefix(name))) if w.startswith(name) else w for w in given] or [
        "--help"
    ]
