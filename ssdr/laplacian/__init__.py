"""Laplacians of a triangle mesh, implicit smoothing and the low/high-frequency split."""

from __future__ import annotations

from .factor import Backend
from .operators import MassKind, cotangent_laplacian, mass_matrix, uniform_laplacian
from .smoothing import FrequencySplit, LaplacianKind, LaplacianSmoother, split_frequencies
from .weight_smoothing import smooth_weights

__all__ = [
    "Backend",
    "FrequencySplit",
    "LaplacianKind",
    "LaplacianSmoother",
    "MassKind",
    "cotangent_laplacian",
    "mass_matrix",
    "smooth_weights",
    "split_frequencies",
    "uniform_laplacian",
]
