"""Animations that ship with the package; where they come from is in ``ORIGIN.md`` beside them."""

from .sample_files import load, names, path

__all__ = ["load", "names", "path"]
