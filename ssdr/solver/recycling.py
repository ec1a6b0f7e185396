"""Names of before, until their callers have changed."""

from .conjugate_gradients import Recycled

__all__ = ["Recycled"]
