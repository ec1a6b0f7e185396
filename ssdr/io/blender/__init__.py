"""Alembic and FBX through Blender, which runs in a process of its own."""

from .bridge import interpreter, read, write_skinning

__all__ = ["interpreter", "read", "write_skinning"]
