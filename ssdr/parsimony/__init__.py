"""Size of models in bytes, and the report of ``ssdr.smallest``."""

from __future__ import annotations

from ..model.size import Size, size
from .report import Attempt, Parsimony, Pruning, Smallest

__all__ = [
    "Attempt",
    "Parsimony",
    "Pruning",
    "Size",
    "Smallest",
    "size",
]
