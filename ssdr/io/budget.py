"""The memory that a file may ask for: one limit for every format."""

from __future__ import annotations

from pathlib import Path

from ..errors import FormatError

__all__ = ["MOST_BYTES", "Budget", "afford"]

MOST_BYTES = 16 << 30  # 16 GiB: more than a mesh needs, less than a false count can ask for


def afford(n_bytes: float, what: str, path: Path | str, most: int | None = None) -> None:
    """Refuse a file that needs more memory than it may, before any of it is allocated.

    Parameters
    ----------
    n_bytes : float
        Memory that reading on would take.
    what : str
        What the file states, such as ``"9600 frames of 800 vertices"``.
    path : path
    most : int, optional
        The caller's `max_bytes`; `MOST_BYTES` by default.

    Raises
    ------
    FormatError
        If `n_bytes` is larger, infinite or no number.
    """
    limit = MOST_BYTES if most is None else most
    if not n_bytes <= limit:
        size = min(n_bytes, 1e18)  # a product of a file's counts may have hundreds of digits
        raise FormatError(
            f"{path}: {what} needs {size:.0f} bytes, above the limit of {limit} "
            "(max_bytes= raises it)"
        )


class Budget:
    """Memory that a scene file may ask for in all: 1000 times its size, but at least 1 GiB.

    A scene states counts, frames and copies of meshes that need no data of their own, so a small
    file can ask for any amount of memory.

    Parameters
    ----------
    path : path
    n_bytes : int
        Size of the file and of what it refers to.
    max_bytes : int, optional
        The caller's limit instead.
    """

    def __init__(self, path: Path | str, n_bytes: int, max_bytes: int | None = None) -> None:
        self.path = path
        self.most = (
            min(MOST_BYTES, max(1 << 30, 1000 * n_bytes)) if max_bytes is None else max_bytes
        )
        self.spent = 0.0

    def spend(self, n_bytes: float, what: str) -> None:
        """Add memory that reading on takes; refuse what goes over the limit, as `afford` does."""
        self.spent += n_bytes
        afford(self.spent, what, self.path, self.most)
