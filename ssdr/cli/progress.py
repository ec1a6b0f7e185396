"""Progress on stderr."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from typing import Any

Show = Callable[[str, float, str], None]


def waiting(text: str) -> contextlib.AbstractContextManager[Any]:
    """Show a text while the block runs."""
    from rich.console import Console
    from rich.text import Text

    return Console(file=sys.stderr).status(Text(text))


@contextlib.contextmanager
def progress_bar() -> Iterator[Show]:
    """Show a bar while the block runs.

    Yields
    ------
    callable
        Takes what is being done, the fraction of the work that is done, and a text.
    """
    from rich.console import Console
    from rich.progress import Progress, TextColumn

    columns = *Progress.get_default_columns(), TextColumn("{task.fields[text]}")
    with Progress(*columns, console=Console(file=sys.stderr), transient=True) as bar:
        task = bar.add_task("preparing", total=1.0, text="")
        yield lambda phase, fraction, text: bar.update(
            task, description=phase, completed=fraction, text=text
        )
