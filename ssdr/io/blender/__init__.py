"""Alembic and FBX through Blender, which runs in a process of its own."""

from .bridge import interpreter, list_clips, read, write_skinning

__all__ = ["interpreter", "list_clips", "read", "write_skinning"]
