"""Stopping a decomposition, and the state that outlives it."""

from __future__ import annotations

import contextlib
import os
import shlex
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from ..errors import InputError, error_text
from ..io.atomic import free_name
from ..signals import handling
from .output import Interrupted, Output

__all__ = ["Stop", "interrupted", "rescue", "save_somewhere", "state_beside", "stopping"]

_ENDING = ".state.npz"


class Stop:
    """Whether somebody has asked to stop."""

    asked = False


@contextlib.contextmanager
def stopping() -> Iterator[Stop]:
    """First SIGINT, SIGTERM or SIGHUP: ask to stop.  A second one: quit at once."""
    stop = Stop()

    def handle(_: int) -> None:
        if stop.asked:
            with contextlib.suppress(OSError, ValueError):
                if sys.stderr.isatty():
                    os.write(2, b"\x1b[?25h\n")  # the progress display hides the cursor
            os._exit(130)
        stop.asked = True
        with contextlib.suppress(OSError):  # a terminal that has hung up
            os.write(2, b"\nssdr: stopping at the next safe point; again to quit at once\n")

    with handling(handle, "SIGINT", "SIGTERM", "SIGHUP"):
        yield stop


def state_beside(output: Path) -> Path:
    """Where the state goes by default: beside the first output, under a name that fits."""
    longest = 255 - len(_ENDING)
    stem = os.fsencode(output.stem)[:longest].decode("utf-8", "ignore")
    return output.with_name(stem + _ENDING)


def save_somewhere(state: Any, path: Path) -> Path:
    """Save a state at `path` or, where that fails, in the next best folder; where it is.

    Tried are the working folder, the folder for temporary files and the user's own; no file
    that is there is overwritten.

    Raises
    ------
    OSError, InputError
        Of the first failure, if all of them fail.
    """
    try:
        state.save(path)
        return path
    except (OSError, InputError) as error:
        first = error
    for folder in _folders(path):
        other = folder / path.name
        if os.path.lexists(other):
            other = other.with_name(free_name(other).name[1:])
        with contextlib.suppress(OSError, InputError):
            state.save(other)
            reason = f"{path}: {first.strerror}" if isinstance(first, OSError) else str(first)
            sys.stderr.write(f"ssdr: {reason}; the state goes to {other} instead\n")
            return other
    raise first


def _folders(path: Path) -> list[Path]:
    tried, folders = {path.parent.resolve()}, []
    for find in (Path.cwd, lambda: Path(tempfile.gettempdir()), Path.home):
        with contextlib.suppress(OSError, RuntimeError):  # the working folder may be gone
            folder = find().resolve()
            if folder not in tried:
                tried.add(folder)
                folders.append(folder)
    return folders


def rescue(error: Exception, state: Any, path: Path, output: Output, files: Iterable[Path]) -> None:
    """Keep what was computed when it could not be written, and say where it is.

    `files` are those that the command writes.
    """
    try:
        place = save_somewhere(state, path)
    except Exception as second:
        sys.stderr.write(f"ssdr: the result is lost: {error_text(second)}\n")
        return
    command = _command(output, place, [*files, path])
    details = {"state": str(place), "resume": command}
    with contextlib.suppress(AttributeError):
        error.details = details  # type: ignore[attr-defined]
    sys.stderr.write(f"ssdr: the result is kept in {place}; write it with: {command}\n")


def interrupted(result: Any, path: Path, output: Output, files: Iterable[Path]) -> Interrupted:
    """The error that ends an interrupted run, once its state is saved."""
    place = save_somewhere(result.state, path)
    command = _command(output, place, [*files, path])
    return Interrupted(
        f"interrupted at RMSE {result.rmse:.4g}; go on with: {command}",
        state=str(place),
        rmse=result.rmse,
        resume=command,
    )


def _command(output: Output, state: Path, files: Iterable[Path]) -> str:
    again = [*_without(output.arguments, "--resume"), "--resume", str(state)]
    # what this run has written already is in the way of the next
    if any(os.path.lexists(f) for f in files if f != state) and "--force" not in again:
        again.append("--force")
    return shlex.join(["ssdr", *again])


def _without(arguments: list[str], option: str) -> list[str]:
    left, skip = [], False
    for argument in arguments:
        if skip or argument.startswith(f"{option}="):
            skip = False
        elif argument == option:
            skip = True
        else:
            left.append(argument)
    return left
