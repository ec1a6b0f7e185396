"""Names of before, until their callers have changed."""

from .gauss_newton import GaussNewton as Polish

__all__ = ["Polish"]
