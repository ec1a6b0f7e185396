"""Representations of results: a few words, whatever the size of arrays, and HTML for notebooks."""

from __future__ import annotations

import dataclasses
import importlib
from typing import Any

import numpy as np


def short_repr(self: Any) -> str:
    """Representation of a dataclass that gives the type and shape of arrays, not their numbers.

    Assign it as the ``__repr__`` of a dataclass with arrays, and again in each derived dataclass.
    """
    fields = ((f.name, getattr(self, f.name)) for f in dataclasses.fields(self) if f.repr)
    parts = (f"{name}={_short(value)}" for name, value in fields)
    return f"{type(self).__name__}({', '.join(parts)})"


def _short(value: Any) -> str:
    if isinstance(value, (bytes, bytearray)):
        return f"<{len(value)} bytes>"
    if isinstance(value, (list, tuple)) and np.size(np.asarray(value, dtype=object)) > 8:
        return f"<{type(value).__name__} of {len(value)}>"
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if shape is not None and dtype is not None and shape != ():
        return f"<{dtype} {tuple(shape)}>"
    return repr(value)


def notebook_html(self: Any) -> str:
    """HTML for a notebook: the ``_repr_html_`` of the classes that :func:`ssdr.view` takes.

    The page is imported when it is shown: what draws models is above the models.
    """
    shown = importlib.import_module("..show.page.notebook", __package__)
    return str(shown.notebook_html(self))
