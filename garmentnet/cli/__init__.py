"""The command ``garmentnet``: simulate, train, evaluate, predict, demo."""

from .app import app, main

__all__ = ["app", "main"]
