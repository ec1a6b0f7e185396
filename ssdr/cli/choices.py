"""Options of the command line with few values."""

from __future__ import annotations

from enum import StrEnum

__all__ = ["BoneModel", "Effort", "Hierarchy", "ToleranceOf"]


class Effort(StrEnum):
    """Where on the curve of speed against accuracy a run lies."""

    fast = "fast"
    balanced = "balanced"
    best = "best"


class BoneModel(StrEnum):
    """What bones may do: turn and move; also grow uniformly; also stretch and shear."""

    rigid = "rigid"
    similarity = "similarity"
    affine = "affine"


class Hierarchy(StrEnum):
    """Which bone hangs on which: none on any; by joints that come apart; by rigid joints."""

    none = "none"
    loose = "loose"
    rigid = "rigid"


class ToleranceOf(StrEnum):
    """Root mean square over all vertices and frames, or the largest distance of any of them."""

    rmse = "rmse"
    max = "max"
