"""Where the command begins: nothing heavy is imported before signals are looked after."""

from __future__ import annotations

from collections.abc import Sequence

from ..signals import quitting_at_once

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process by default.
    """
    with quitting_at_once("ssdr: interrupted"):
        from .app import run
    return run(arguments)
