"""One self-contained web page that shows a model beside its input."""

from __future__ import annotations

from .page import Page, view

__all__ = ["Page", "view"]
