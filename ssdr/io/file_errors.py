"""Files that may be damaged or hostile: errors that name the file, and limits of memory."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..common.errors import FormatError, InputError, SsdrError

_log = logging.getLogger(__name__)
_BUGS: dict[type[Exception], str] = {
    KeyError: "it has no {}",
    IndexError: "it refers to something that is not there",
    TypeError: "an entry holds another kind of value than the format says",
    AttributeError: "an entry holds another kind of value than the format says",
}
MOST_BYTES = 16 << 30  # 16 GiB: more than a mesh needs, less than a false count can ask for


@contextlib.contextmanager
def reading(path: Path, *options: str) -> Iterator[None]:
    """Turn errors of a parser inside the block into a FormatError that names the file.

    An InputError inside the block becomes a FormatError, too, because it is about the contents of
    the file, unless it is about one of the `options` of the caller. Errors of a missing file,
    permission or package stay as they are.
    """
    try:
        refuse_device(path)
        yield
    except Exception as error:
        missing = isinstance(error, FileNotFoundError) and not path.exists()
        named = isinstance(error, FormatError) and str(error).startswith(str(path))
        of_caller = isinstance(error, InputError) and error.argument in options
        of_no_file = isinstance(error, SsdrError) and not isinstance(error, ValueError)
        kept = of_caller or of_no_file or isinstance(error, (PermissionError, UserWarning))
        if missing or named or kept:
            raise
        what = str(error) or type(error).__name__
        if isinstance(error, MemoryError):
            what = "needs more memory than there is"
        elif not isinstance(error, (FormatError, InputError, FileNotFoundError)):
            # On hostile bytes a parser may raise any error, even one about its own code.
            _log.debug("%s", path, exc_info=error)
            said = [text for kind, text in _BUGS.items() if isinstance(error, kind)]
            what = f"truncated or damaged ({said[0].format(what) if said else what})"
        raise FormatError(f"{path}: {what}") from error


def check(valid: Any, problem: str) -> None:
    """Raise a FormatError with the text `problem` unless `valid` is true."""
    if not valid:
        raise FormatError(problem)


def refuse_device(path: Path) -> None:
    """Raise a FormatError for a device, a pipe or a socket, because reading it may never end.

    Raises
    ------
    FormatError
        If `path` exists and is neither a file nor a folder.
    """
    usual = path.is_file() or path.is_dir() or not path.exists()
    check(usual, f"{path}: a device, a pipe or a socket, not a file")


def read_file(path: Path) -> bytes:
    """Check the size of a file and read all its bytes; to be called inside :func:`reading`."""
    afford(path.stat().st_size, "the whole file", path)
    return path.read_bytes()


def afford(n_bytes: float, what: str, path: Path | str, most: int | None = None) -> None:
    """Raise a FormatError if a file needs more memory than the limit, before it is allocated.

    Parameters
    ----------
    n_bytes : float
        Memory that reading the file would take.
    what : str
        What needs the memory, such as ``"9600 frames of 800 vertices"``.
    path : path
    most : int, optional
        Limit in bytes, which is the caller's `max_bytes`; `MOST_BYTES` by default.

    Raises
    ------
    FormatError
        If `n_bytes` is larger than the limit, or NaN.
    """
    limit = MOST_BYTES if most is None else most
    if not n_bytes <= limit:
        size = min(n_bytes, 1e18)  # a product of a file's counts may have hundreds of digits
        raise FormatError(
            f"{path}: {what} needs {size:.0f} bytes, above the limit of {limit} "
            "(max_bytes= raises it where the format has that option)"
        )


class SceneBudget:
    """Limit of the memory that a scene file may ask for: 1000 times its size, from 1 to 16 GiB.

    The limit is needed because a small file can ask for any amount of memory: it can state counts,
    frames and copies of meshes without holding data for each.

    Parameters
    ----------
    path : Path
    n_bytes : int
        Size of the file and of the files that it refers to.
    max_bytes : int, optional
        Limit set by the caller, used in place of that by size.
    """

    def __init__(self, path: Path, n_bytes: int, max_bytes: int | None = None) -> None:
        self.path, self.spent, self._fixed = path, 0.0, max_bytes
        self.most = 1 << 30 if max_bytes is None else max_bytes
        self.grow(n_bytes)

    def grow(self, n_bytes: int) -> None:
        """Raise the limit for another file of `n_bytes`, unless the caller has set it."""
        if self._fixed is None:
            self.most = min(MOST_BYTES, max(self.most, 1000 * n_bytes))

    def spend(self, n_bytes: float, what: str) -> None:
        """Add `n_bytes` to the memory needed so far, and check the sum against the limit.

        `what` names what needs these bytes, for the error message.

        Raises
        ------
        FormatError
            If the sum exceeds the limit; see :func:`afford`.
        """
        self.spent += n_bytes
        afford(self.spent, what, self.path, self.most)
