"""A script that reads or writes a file in a process of its own, since its library may crash."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.errors import FormatError, MissingDependencyError, SsdrError
from ..mesh.clips import readable

_log = logging.getLogger(__name__)
_READER = Path(__file__).with_name("reading_process.py")
_TIME_LIMIT = 600.0  # seconds after which a process is ended


def run_reader(
    script: Path, job: Mapping[str, Any], who: str, path: Path
) -> tuple[Any, dict[str, NDArray[Any]]]:
    """Run a script's function `read` in a Python of its own, for the file `path`.

    Returns the record and the arrays of `read`. `job` holds the limit of memory as ``"max_bytes"``.
    Errors are those of :func:`run_script`.
    """
    arrays = run_script(
        [sys.executable, "-P", str(_READER)],
        {"path": str(path.resolve()), "script": str(script), "who": who, **job},
        who=who,
        # what can be imported here can be imported there
        environment={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        path=path,
    )
    return json.loads(arrays.pop("found").tobytes()), arrays


def run_script(
    words: Sequence[str],
    job: Mapping[str, Any],
    *,
    who: str,
    environment: Mapping[str, str],
    path: Path | None = None,
) -> dict[str, NDArray[Any]]:
    """Run a script in a process of its own, and return the arrays that it writes to an archive.

    Parameters
    ----------
    words : sequence of str
        Command line, to which the path of the file with the script's job is added.
    job : dict
        What the script is to do, as JSON. The path of the archive is added to it as ``"out"``.
    who : str
        Name of the program that runs the script, for messages.
    environment : dict
        Environment variables of the process.
    path : Path, optional
        File that the script reads, which is blamed for errors.

    Raises
    ------
    MissingDependencyError
        If the program cannot be started.
    SsdrError
        If it ends with an error, whose text is passed on, writes one as the array ``"error"``, or
        takes longer than ten minutes. With `path`, it is a FormatError.
    """
    with tempfile.TemporaryDirectory(prefix="ssdr-") as folder:
        out, order = Path(folder) / "out.npz", Path(folder) / "job.json"
        order.write_text(json.dumps({**job, "out": str(out)}), encoding="utf-8")
        try:
            done = subprocess.run(
                [*words, str(order)],
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_TIME_LIMIT,
                cwd=folder,
                env=dict(environment),
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise _blaming(path, f"{who} needed more than {_TIME_LIMIT:g} s") from error
        except OSError as error:
            raise MissingDependencyError(f"{words[0]} could not be started: {error}") from error
        _log.debug("%s: %s%s", who, done.stdout, done.stderr)
        if done.returncode != 0 or not out.is_file():
            lines = [line.strip() for line in done.stderr.splitlines() if line.strip()]
            reason = (lines or ["it said nothing"])[-1][-600:]  # the end of a traceback
            damaged = "truncated or damaged: " if path else ""
            raise _blaming(path, f"{damaged}{who} failed ({done.returncode}): {reason}")
        with np.load(out, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
    if "error" in arrays:
        raise _blaming(path, readable(arrays["error"]))
    return arrays


def _blaming(path: Path | None, problem: str) -> SsdrError:
    return SsdrError(problem) if path is None else FormatError(f"{path}: {problem}")
