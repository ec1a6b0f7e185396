"""Optional packages, imported where they are used."""

from __future__ import annotations

from ssdr.io.registry import import_optional as require

__all__ = ["require"]
