"""The command ``garmentnet``: import, train, evaluate, predict, export, demo."""

from .app import app, main

__all__ = ["app", "main"]
