"""Process in which Blender runs one job of ``script.py``."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ...errors import MissingDependencyError, SsdrError
from ..process import run_script
from .finder import command

SCRIPT = Path(__file__).with_name("script.py")
_TOO_OLD = "Blender 4.2 or newer is needed"  # part of an error of script.py
_log = logging.getLogger(__name__)


def run(job: dict[str, Any], *, time_limit: float = 600.0) -> dict[str, NDArray[Any]]:
    """Run one job of ``script.py`` in a process of its own and return the arrays that it writes.

    Raises
    ------
    InputError, MissingDependencyError
        If Blender is not found, cannot be started or is older than 4.2.
    SsdrError
        If Blender stops with an error, whose text is passed on, or takes more than `time_limit`
        seconds.
    """
    # Blender's Python must see its own packages, not those of this process.
    hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    environment = {k: v for k, v in os.environ.items() if k not in hidden}

    def words(order: str) -> list[str]:
        return command(SCRIPT, order)

    try:
        return run_script(words, job, who="Blender", environment=environment, time_limit=time_limit)
    except SsdrError as error:
        reason = str(error)
        if _TOO_OLD in reason or "No module named 'bpy'" in reason:
            said = reason.split(": ", 1)[-1]
            raise MissingDependencyError(f"{words('')[0]}: {said}") from error
        raise
