"""Sequences of numbered mesh files: OBJ and PLY."""
