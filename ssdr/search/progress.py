"""What a callback gets after every step, and what the history keeps."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

__all__ = ["Callback", "Progress", "Record"]


@dataclasses.dataclass(frozen=True)
class Record:
    """One accepted model of exactly the bones and influences asked for.

    Attributes
    ----------
    iteration : int
        Alternations and polish steps so far.
    elapsed : float
        Seconds since the call, initialisation included, compilation not.
    rmse : float
        sqrt(Σ|d|² / (F V)) over all frames, in the mesh's units.
    phase : str
        The step that found it.
    """

    iteration: int
    elapsed: float
    rmse: float
    phase: str


@dataclasses.dataclass(frozen=True)
class Progress:
    """What a callback is told after every step.

    Attributes
    ----------
    phase : str
    iteration : int
    elapsed : float
        Seconds.
    rmse : float
        Of the best model so far, in the mesh's units; inf before there is one.
        Weighted by the importances, where there are any.
    fraction : float
        Estimated share of the work that is done, 0 to 1.
    time_left : float
        Estimate in seconds.
    """

    phase: str
    iteration: int
    elapsed: float
    rmse: float
    fraction: float
    time_left: float


Callback = Callable[[Progress], bool | None]
