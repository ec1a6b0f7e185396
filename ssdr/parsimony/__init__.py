"""The search of ``ssdr.smallest`` and its report; what a model takes to store."""

from __future__ import annotations

from ..model.size import Size, size
from .report import Parsimony, Pruning, Smallest

__all__ = [
    "Parsimony",
    "Pruning",
    "Size",
    "Smallest",
    "size",
]
