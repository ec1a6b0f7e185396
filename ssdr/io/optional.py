"""Packages that may be missing, imported where they are needed."""

from __future__ import annotations

import importlib
from typing import Any

from ..errors import MissingDependencyError


def require(module: str, extra: str, what: str) -> Any:
    """Import a package that ``ssdr[extra]`` installs, by :func:`import_optional`."""
    return import_optional(module, f"ssdr[{extra}]", what)


def import_optional(module: str, requirement: str, what: str) -> Any:
    """Import a package that may be missing.

    Parameters
    ----------
    module : str
    requirement : str
        Argument of ``pip install`` that installs the package.
    what : str
        What needs the package; the error message begins with it.

    Raises
    ------
    MissingDependencyError
        If the package is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingDependencyError(
            f'{what} needs the package {module}: pip install "{requirement}"'
        ) from error
