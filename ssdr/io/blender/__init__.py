"""Alembic and FBX through Blender, which runs in a process of its own."""

from .bridge import read, write_skinning
from .finder import command, environment

__all__ = ["command", "environment", "read", "write_skinning"]
