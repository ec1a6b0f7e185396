"""Packages that may be missing, imported where they are needed."""

from __future__ import annotations

import importlib.util
from typing import Any

from ..common.errors import MissingDependencyError

# Packages of the extras, for pip: ``ssdr`` is in no index, where anyone may take its name.
PACKAGES = {
    "alembic": "alembic3d>=1.8.12",
    "draco": "DracoPy>=2.0",
    "meshopt": "meshoptimizer>=0.2.30a0",
    "usd": "usd-core>=24.8",
    "zarr": "zarr>=3.0",
}


def require(module: str, extra: str, what: str) -> Any:
    """Import a package that belongs to the optional dependencies `extra`, and return it.

    `what` begins the error message, as in :func:`import_optional`.
    """
    return import_optional(module, PACKAGES[extra], what)


def check_installed(module: str, extra: str, what: str) -> None:
    """Raise the error of :func:`require` if a package is not installed, without importing it."""
    if importlib.util.find_spec(module) is None:
        raise _missing(PACKAGES[extra], what)


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
        raise _missing(requirement, what) from error


def _missing(requirement: str, what: str) -> MissingDependencyError:
    return MissingDependencyError(
        f'{what} needs a package that is not installed: pip install "{requirement}"'
    )
