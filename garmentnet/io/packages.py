"""Optional packages, imported where they are used."""

from __future__ import annotations

import importlib
from typing import Any

from ssdr.errors import MissingDependencyError

__all__ = ["require"]


def require(module: str, requirement: str, what: str) -> Any:
    """Import a package that may be missing.

    Parameters
    ----------
    module : str
    requirement : str
        What brings it, as pip knows it: ``"garmentnet[scenes]"``.
    what : str
        What needs it, at the start of the message.

    Raises
    ------
    MissingDependencyError
        If it is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingDependencyError(
            f'{what} needs the package {module}: pip install "{requirement}"'
        ) from error
