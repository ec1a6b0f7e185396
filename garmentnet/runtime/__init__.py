"""Prediction of a garment frame by frame from an ONNX file, without torch."""

from .garment import LiveGarment

__all__ = ["LiveGarment"]
