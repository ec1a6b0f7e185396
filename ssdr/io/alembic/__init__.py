"""Alembic: caches of moving meshes, by alembic3d or, where that is missing, by Blender."""

from __future__ import annotations

from .reader import list_meshes, read
from .writer import write_sequence

__all__ = ["list_meshes", "read", "write_sequence"]
