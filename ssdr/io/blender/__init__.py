"""Alembic and FBX through Blender, which runs in a process of its own."""

from .bridge import list_clips, read, read_skinning, write_skinning
from .finder import command, environment

__all__ = ["command", "environment", "list_clips", "read", "read_skinning", "write_skinning"]
