"""Prediction of a garment frame by frame from an ONNX file, without torch."""

from .garment import LiveGarment
from .player import Player

__all__ = ["LiveGarment", "Player"]
