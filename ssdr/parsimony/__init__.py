"""Size of models in bytes, curves of error against size, and the report of ``ssdr.smallest``."""

from __future__ import annotations

from ..storage.size import Size, size
from .rate_distortion import Curve, curve
from .report import Attempt, FileSize, Parsimony, Pruning, Smallest

__all__ = [
    "Attempt",
    "Curve",
    "FileSize",
    "Parsimony",
    "Pruning",
    "Size",
    "Smallest",
    "curve",
    "size",
]
