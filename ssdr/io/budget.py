"""Limit of the memory that a file of any format may ask for."""

from __future__ import annotations

from pathlib import Path

from ..errors import FormatError

MOST_BYTES = 16 << 30  # 16 GiB: more than a mesh needs, less than a false count can ask for
# Data above this size that inflate by more than this ratio are refused: frames of a real
# animation shrink to a tenth at best, and a small file must not fill the memory.
_MOST_RATIO, _UNSUSPICIOUS_BYTES = 100, 256 << 20


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


def refuse_bomb(
    n_bytes: int, stored: int, what: str, path: Path | str, most: int | None = None
) -> None:
    """Raise a FormatError for compressed data like a zip bomb, before they are inflated.

    Parameters
    ----------
    n_bytes, stored : int
        Size of the inflated data, and of the compressed data in the file.
    what, path
        As for :func:`afford`.
    most : int, optional
        The caller's `max_bytes`; if it is given, any ratio is accepted.

    Raises
    ------
    FormatError
        If `n_bytes` is above 256 MiB and 100 times `stored`.
    """
    if most is None and n_bytes > max(_UNSUSPICIOUS_BYTES, _MOST_RATIO * stored):
        raise FormatError(
            f"{path}: {what} needs {n_bytes} bytes, inflated {n_bytes // max(1, stored)}-fold like "
            f"a zip bomb; max_bytes={n_bytes} admits it"
        )
