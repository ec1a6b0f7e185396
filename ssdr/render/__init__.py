"""Pictures of sequences and skinnings, without a display: one frame, a contact sheet, a film."""

from __future__ import annotations

from .figures import contact_sheet, render_frame, write_picture
from .film import Film, animate
from .parts import CLAY, FABRIC, NEUTRAL, SKIN, Part
from .raster import Camera
from .scene import Style

__all__ = [
    "CLAY",
    "FABRIC",
    "NEUTRAL",
    "SKIN",
    "Camera",
    "Film",
    "Part",
    "Style",
    "animate",
    "contact_sheet",
    "render_frame",
    "write_picture",
]
