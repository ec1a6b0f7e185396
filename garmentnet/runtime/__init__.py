"""A garment predicted frame by frame with NumPy and Numba alone; no torch here."""

from .garment import LiveGarment, LiveState, load_live
from .player import Player

__all__ = ["LiveGarment", "LiveState", "Player", "load_live"]
