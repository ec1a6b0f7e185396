"""Names of before, until their callers have changed."""

from .gauge import normalise_gauge
from .gauss_newton import GaussNewton as polish_of
from .gauss_newton import fit_motion

__all__ = ["fit_motion", "normalise_gauge", "polish_of"]
