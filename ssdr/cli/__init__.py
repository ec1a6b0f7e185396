"""The command ``ssdr``: decompose, info, compare, convert, render."""

from .app import app, main

__all__ = ["app", "main"]
