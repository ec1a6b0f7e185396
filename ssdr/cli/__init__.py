"""The command ``ssdr``: decompose, info, compare, convert, render."""

from .entry import main

__all__ = ["main"]
