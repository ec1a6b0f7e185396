"""Process in which Blender runs one job of ``script.py``."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...clips import readable
from ...errors import MissingDependencyError, SsdrError
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
    with tempfile.TemporaryDirectory(prefix="ssdr-") as folder:
        out, order = Path(folder) / "out.npz", Path(folder) / "job.json"
        order.write_text(json.dumps({**job, "out": str(out)}), encoding="utf-8")
        words = command(SCRIPT, str(order))
        # Blender's Python must see its own packages, not those of this process.
        hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
        environment = {k: v for k, v in os.environ.items() if k not in hidden}
        try:
            done = subprocess.run(
                words,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=time_limit,
                cwd=folder,
                env=environment,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise SsdrError(f"Blender needed more than {time_limit:g} s") from error
        except OSError as error:
            raise MissingDependencyError(f"{words[0]} could not be started: {error}") from error
        _log.debug("blender: %s%s", done.stdout, done.stderr)
        if done.returncode != 0 or not out.is_file():
            lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
            reason = (lines or ["it said nothing"])[-1][-600:]  # of a traceback, what it ends in
            if _TOO_OLD in reason or "No module named 'bpy'" in reason:
                raise MissingDependencyError(f"{words[0]}: {reason}")
            raise SsdrError(f"Blender failed ({done.returncode}): {reason}")
        with np.load(out, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        if "error" in arrays:
            raise SsdrError(readable(arrays["error"]))
        return arrays
