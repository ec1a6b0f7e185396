"""No more model than a scene needs: size in bytes, and error against size."""

from __future__ import annotations

from .rate_distortion import Curve, curve
from .report import Attempt, Parsimony, Pruning, Size, Smallest, size

__all__ = ["Attempt", "Curve", "Parsimony", "Pruning", "Size", "Smallest", "curve", "size"]
