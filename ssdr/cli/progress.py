"""Status line and progress bar on stderr."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from typing import Any

Show = Callable[[str, float, str], None]


def waiting(text: str) -> contextlib.AbstractContextManager[Any]:
    """Context that shows a text on stderr while its block runs."""
    from rich.console import Console
    from rich.text import Text

    return Console(file=sys.stderr).status(Text(text))


@contextlib.contextmanager
def progress_bar() -> Iterator[Show]:
    """Show a progress bar on stderr while the block runs.

    Yields
    ------
    callable
        Function that updates the bar with the name of the phase, the fraction of the work that is
        done, and a text.
    """
    from rich.console import Console
    from rich.progress import Progress, TextColumn

    columns = *Progress.get_default_columns(), TextColumn("{task.fields[text]}")
    with Progress(*columns, console=Console(file=sys.stderr), transient=True) as bar:
        task = bar.add_task("preparing", total=1.0, text="")
        yield lambda phase, fraction, text: bar.update(
            task, description=phase, completed=fraction, text=text
        )
