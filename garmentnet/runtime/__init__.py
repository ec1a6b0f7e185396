"""Prediction of a garment frame by frame with NumPy and Numba alone, without torch."""

from .garment import LiveGarment, LiveState, load_live
from .player import Player

__all__ = ["LiveGarment", "LiveState", "Player", "load_live"]
