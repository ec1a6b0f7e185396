"""Skinning decomposition: rest pose, sparse skin weights and rigid bones from an animated mesh.

Names are imported when they are first used, so that ``import ssdr`` is quick.  The public ones are
listed in ``__init__.pyi``, which type checkers read as well.
"""

from __future__ import annotations

import ast
import importlib
from pathlib import Path
from typing import Any

__version__ = "0.1.0"

_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
# Package or module that each public name is imported from; "" if that is this package.
_HOME = {
    alias.name: node.module or ""
    for node in ast.parse(_STUB).body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}
__all__ = sorted([*_HOME, "__version__"])


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = f"{__name__}.{_HOME[name]}".rstrip(".")
    module = importlib.import_module(home)
    if module.__name__ != __name__ and hasattr(module, name):
        value = getattr(module, name)
    else:  # the name is that of a module
        value = importlib.import_module(f"{home}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
