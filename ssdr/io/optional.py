"""Packages that may be missing, imported where they are needed."""

from __future__ import annotations

import importlib.util
from typing import Any

from ..common.errors import MissingDependencyError
from ..common.signals import interrupted_after

# Module that is imported for each extra, and its package for pip: ``ssdr`` is in no index, where
# anyone may take its name.
PACKAGES = {
    "alembic": ("alembic3d", "alembic3d>=1.8.12"),
    "draco": ("DracoPy", "DracoPy>=2.0"),
    "fbx": ("ufbx", "ufbx>=0.0.5"),
    "meshopt": ("meshoptimizer", "meshoptimizer>=0.2.30a0"),
    "usd": ("pxr.UsdSkel", "usd-core>=24.8"),
}


def require(extra: str, what: str) -> Any:
    """Import the module of the optional dependencies `extra`, and return it.

    `what` begins the error message, as in :func:`import_optional`.
    """
    return import_optional(*PACKAGES[extra], what)


def check_installed(extra: str, what: str) -> None:
    """Raise the error of :func:`require` if a package is not installed, without importing it."""
    module, requirement = PACKAGES[extra]
    if importlib.util.find_spec(module) is None:
        raise _missing(requirement, what)


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
        with interrupted_after():
            return importlib.import_module(module)
    except ImportError as error:
        raise _missing(requirement, what) from error


def _missing(requirement: str, what: str) -> MissingDependencyError:
    return MissingDependencyError(
        f'{what} needs a package that is not installed: pip install "{requirement}"'
    )
