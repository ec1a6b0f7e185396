"""Pictures of sequences and skinnings, without a display: one frame, a contact sheet, a film."""

from __future__ import annotations

from .figures import contact_sheet, render_frame, write_picture
from .film import animate
from .materials import FABRIC, NEUTRAL, SKIN, Material, Part
from .raster import Camera
from .scene import Style

__all__ = [
    "FABRIC",
    "NEUTRAL",
    "SKIN",
    "Camera",
    "Material",
    "Part",
    "Style",
    "animate",
    "contact_sheet",
    "render_frame",
    "write_picture",
]
