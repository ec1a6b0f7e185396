"""Alembic and FBX through Blender, which runs in a process of its own."""

from .bridge import left_out, list_clips, read, read_skinning, write_skinning
from .finder import command, environment

__all__ = [
    "command",
    "environment",
    "left_out",
    "list_clips",
    "read",
    "read_skinning",
    "write_skinning",
]
