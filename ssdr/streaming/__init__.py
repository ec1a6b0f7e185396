"""Sequences larger than memory: solve on representative frames, finish on all of them."""
