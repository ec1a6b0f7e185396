"""Prediction of a garment frame by frame from an ONNX file, without torch.

:mod:`.onnx_file`, which needs torch, writes the file.
"""

from .garment import LiveGarment

__all__ = ["LiveGarment"]
