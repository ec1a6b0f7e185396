"""The command ``ssdr``, whose entry point is :func:`main`."""

from __future__ import annotations

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments of the command; by default those of the process.
    """
    try:
        from .app import run

        return run(arguments)
    except KeyboardInterrupt:  # while modules are imported
        sys.stderr.write("ssdr: interrupted\n")
        return 130
