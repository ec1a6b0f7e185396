"""Pictures of sequences and skinnings, without a display: one frame, a contact sheet, a film."""

from __future__ import annotations

from .figures import animate, contact_sheet, render_frame, write_picture
from .raster import Camera
from .scene import Style

__all__ = ["Camera", "Style", "animate", "contact_sheet", "render_frame", "write_picture"]
