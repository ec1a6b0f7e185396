"""Pictures of sequences and skinnings, without a display: one frame, a contact sheet, a film."""

from __future__ import annotations

from .figures import Film, contact_sheet, draw, render_frame, write_picture
from .palette import CLAY, FABRIC, NEUTRAL, SKIN
from .subject import Style

__all__ = [
    "CLAY",
    "FABRIC",
    "NEUTRAL",
    "SKIN",
    "Film",
    "Style",
    "contact_sheet",
    "draw",
    "render_frame",
    "write_picture",
]
