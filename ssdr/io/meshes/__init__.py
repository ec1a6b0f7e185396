"""Sequences of numbered mesh files: OBJ, PLY, OFF and STL."""
