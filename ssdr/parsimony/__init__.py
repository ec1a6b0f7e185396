"""The search of ``ssdr.smallest`` for the smallest model, by bytes that an engine stores."""

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
