"""Progress on stderr."""

from __future__ import annotations

import contextlib
import math
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
    from rich.progress import BarColumn, Progress, TextColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=None),
        TextColumn("{task.percentage:>3.0f} %  {task.fields[text]}"),
    )
    with Progress(*columns, console=Console(file=sys.stderr), transient=True, expand=True) as bar:
        task = bar.add_task("preparing", total=1.0, text="")
        yield lambda phase, fraction, text: bar.update(
            task, description=phase, completed=fraction, text=text
        )


def times_text(elapsed: float, left: float | None, rmse: float | None = None) -> str:
    """Error, time and time left, as far as they are known, in a few words."""
    parts = [] if rmse is None or not math.isfinite(rmse) else [f"RMSE {rmse:.4g}"]
    parts.append(_span(elapsed))
    if left is not None and math.isfinite(left):
        parts.append(f"{_span(left)} left")
    return ", ".join(parts)


def _span(seconds: float) -> str:
    whole = max(0, math.ceil(seconds))
    return f"{whole} s" if whole < 100 else f"{whole // 60} min {whole % 60:02d} s"
