"""Sequences of numbered mesh files: OBJ, PLY, OFF and STL."""

from .numbered import read, write_sequence

__all__ = ["read", "write_sequence"]
