"""Errors of an animated mesh against a reference: distances, Hausdorff, STED, or all at once."""

from __future__ import annotations

from ..model.drawn_normals import NormalErrors
from .comparison import Comparison, compare
from .edge_difference import Sted, sted
from .hausdorff_distance import Hausdorff, hausdorff
from .normal_angles import normals
from .vertex_distances import Distances, distances, rmse

__all__ = [
    "Comparison",
    "Distances",
    "Hausdorff",
    "NormalErrors",
    "Sted",
    "compare",
    "distances",
    "hausdorff",
    "normals",
    "rmse",
    "sted",
]
