"""How far an animated mesh is from a reference: distances, Hausdorff, STED, or all in one call."""

from __future__ import annotations

from ._comparison import Comparison, compare
from ._distances import Distances, distances, rmse
from ._hausdorff import Hausdorff, hausdorff
from ._sted import Sted, sted

__all__ = [
    "Comparison",
    "Distances",
    "Hausdorff",
    "Sted",
    "compare",
    "distances",
    "hausdorff",
    "rmse",
    "sted",
]
