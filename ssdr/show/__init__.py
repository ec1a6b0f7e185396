"""Pictures of sequences and skinnings, without a display: one frame, a contact sheet, a film."""

from __future__ import annotations

from .drawing import draw
from .figures import contact_sheet, render_frame, write_picture
from .film import Film
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
