"""The command ``garmentnet``: every step from clips to pictures.

Commands import what they need when they run: ``--help`` is fast, and a command works without the
extras that only others need.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import typer

from ssdr.cli.output import Output
from ssdr.cli.shell import run_app

from .importing import import_clips
from .learning import demo, evaluate, export, predict, train

app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Loose garments on a moving body: import clips, learn, predict.",
)


for _command in (train, evaluate, predict, export, demo):
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
    return run_app(
        "garmentnet",
        lambda: app,
        lambda: words or ["--help"],
        Output(),
        interrupted="stopped; the same command again goes on where it was",
        raises=True,
    )
