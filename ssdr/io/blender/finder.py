"""Lookup of Blender, as a program or as a Python in which ``bpy`` is installed, and its runs.

``bpy`` requires an old NumPy and would downgrade that of ``ssdr``, so it belongs into a Python
environment of its own. An environment in the folder that `environment` returns is found without any
settings.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ...common.errors import InputError, MissingDependencyError, SsdrError
from ..own_process import run_script

_TOO_OLD = "Blender 4.2 or newer is needed"  # part of an error of write_script.py
_OWN_PACKAGES = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")  # of this process, not of Blender


def run(script: Path, job: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """Run a script in Blender, in a process of its own, and return the arrays that it writes.

    Parameters
    ----------
    script, job
        As for :func:`ssdr.io.own_process.run_script`.

    Raises
    ------
    InputError, MissingDependencyError
        If Blender is not found, cannot be started or is older than 4.2.
    SsdrError
        If Blender stops with an error, whose text is passed on, or takes too long.
    """
    words = command(script)
    environment = {k: v for k, v in os.environ.items() if k not in _OWN_PACKAGES}
    try:
        return run_script(words, job, who="Blender", environment=environment)
    except SsdrError as error:
        reason = str(error)
        if _TOO_OLD in reason or "No module named 'bpy'" in reason:
            said = reason.rsplit(": ", 1)[-1]
            raise MissingDependencyError(f"{words[0]}: {said}") from error
        raise


def environment() -> Path:
    """Folder in which a Python environment with ``bpy`` is looked for; it need not exist.

    It is ``ssdr/blender`` in the user's cache folder, which is ``~/Library/Caches`` on macOS,
    ``%LOCALAPPDATA%`` on Windows, and ``$XDG_CACHE_HOME`` or ``~/.cache`` elsewhere.
    """
    home = Path.home()
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = home / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or home / ".cache"
    return Path(base) / "ssdr" / "blender"


def command(script: Path | str, *arguments: str) -> list[str]:
    """Command line that runs a script with ``bpy``, found without importing ``bpy``.

    The command uses the first of these that exists: the Blender program that the environment
    variable ``SSDR_BLENDER`` names, the Python that ``SSDR_BLENDER_PYTHON`` names, the Python that
    is running if ``bpy`` is installed in it, the Python in the folder that `environment` returns,
    the program ``blender`` on the PATH.

    Parameters
    ----------
    script : Path or str
    arguments : str
        Arguments of the script, at the end of its ``sys.argv``.

    Returns
    -------
    list of str

    Raises
    ------
    InputError
        If one of the two variables names something that cannot be run.
    MissingDependencyError
        If Blender is not found; the message says how to get it.
    """
    blender = _named("SSDR_BLENDER", "a Blender program")
    python = None if blender else _named("SSDR_BLENDER_PYTHON", "a Python with bpy")
    if not (blender or python):
        here = sys.executable if importlib.util.find_spec("bpy") is not None else None
        python = here or _python_of(environment())
        blender = None if python else shutil.which("blender")
    if python:
        return [python, str(script), *arguments]
    if not blender:
        raise MissingDependencyError(_how())
    # The user's own start-up file and add-ons must not change what is read.
    options = ["--background", "--factory-startup", "--python-exit-code", "1"]
    return [blender, *options, "--python", str(script), "--", *arguments]


def _named(variable: str, what: str) -> str | None:
    name = os.environ.get(variable, "")
    found = shutil.which(name) if name else None
    if name and found is None:
        raise InputError(variable, what, repr(name))
    return found


def _scripts(folder: Path) -> Path:
    return folder / ("Scripts" if sys.platform == "win32" else "bin")


def _python_of(folder: Path) -> str | None:
    """Python of the environment in a folder, or None if ``bpy`` is not installed in it."""
    places = [*folder.glob("lib/python*/site-packages/bpy"), folder / "Lib/site-packages/bpy"]
    installed = any(place.is_dir() for place in places)
    return shutil.which("python", path=_scripts(folder)) if installed else None


def _how() -> str:
    folder = environment()
    python = "py -3.11" if sys.platform == "win32" else "python3.11"
    make = f'{python} -m venv "{folder}" && "{_scripts(folder) / "pip"}" install bpy'
    return (
        "Blender, 4.2 or newer, was not found: put it on the PATH, name it in SSDR_BLENDER, or "
        f"give it an environment of its own with: {make} "
        "(bpy 4.2 to 5.0 need Python 3.11)"
    )
