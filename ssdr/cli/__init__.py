"""The command ``ssdr``, whose entry point is :func:`main`."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments of the command; by default those of the process.
    """
    _open_streams()
    try:
        from .app import run

        return run(arguments)
    except KeyboardInterrupt:  # while modules are imported
        sys.stderr.write("ssdr: interrupted\n")
        return 130
    except (ImportError, MemoryError) as error:  # then, too: run reports those of the work
        said = (str(error).strip() or "no memory").splitlines()[-1]
        sys.stderr.write(f"ssdr: error: a package cannot be loaded ({said}): is memory limited?\n")
        return 1


def _open_streams() -> None:
    """Put the null device in the place of standard streams that are closed, as by cron or ``2>&-``.

    A file that is opened would get their number, and messages would be written into it.
    """
    for number in range(3):
        with contextlib.suppress(OSError):
            os.fstat(number)
            continue
        os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
