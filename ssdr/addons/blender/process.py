"""Child processes that do not block Blender, and the Python environment of ssdr."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Generator
from pathlib import Path

_STEP = re.compile(r"DEBUG \S+ (.+), iteration \d+, rmse (\S+), (\d+) % done")


class AddonError(Exception):
    """Error whose message is shown to the user."""


def python_in(folder: Path) -> Path:
    """Path of the Python executable in a virtual environment."""
    return folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")


def installation(environment: Path, source: str, online: bool) -> list[list[str]]:
    """Commands that make an environment and install ssdr into it.

    `source` is a wheel, or a folder that holds the wheels of ssdr and of all that it needs.
    `online` says whether pip may fetch what a single wheel needs; ssdr itself is in no package
    index, where anyone could take its name.
    """
    if not source:
        raise AddonError(
            "Choose what to install from: a wheel of ssdr, or a folder with it and what it needs"
        )
    alone = ["--isolated", "--no-index"]
    if Path(source).is_dir():
        what = [*alone, "--find-links", source, "ssdr"]
    elif source.endswith(".whl") and Path(source).is_file():
        what = [*([] if online else alone), "--find-links", str(Path(source).parent), source]
    else:
        raise AddonError(f"{source} is neither a wheel nor a folder of wheels")
    python = str(python_in(environment))
    return [
        [sys.executable, "-m", "venv", "--clear", str(environment)],
        [python, "-m", "pip", "install", "--disable-pip-version-check", "--no-input", *what],
        [python, "-m", "ssdr", "--version"],
    ]


def follow(words: list[str], folder: Path) -> Generator[str, None, str]:
    """Run a command, and repeatedly yield the last line of its stderr until it ends.

    Its output is written to files in `folder`.  The generator returns what the command wrote to
    stdout.  Closing the generator kills the process.
    """
    out, err = folder / "stdout.txt", folder / "stderr.txt"
    hidden = {"creationflags": 0x08000000} if sys.platform == "win32" else {}  # no console window
    # The other Python must see its own packages, not those of Blender.
    left_out = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    variables = {name: value for name, value in os.environ.items() if name not in left_out}
    with out.open("wb") as stdout, err.open("wb") as stderr:
        try:
            process = subprocess.Popen(
                words,
                cwd=folder,
                env=variables,
                stdin=subprocess.DEVNULL,
                stdout=stdout,
                stderr=stderr,
                **hidden,
            )
        except OSError as error:
            raise AddonError(f"{words[0]} cannot be run: {error.strerror}") from error
        try:
            while process.poll() is None:
                yield _last_line(err)
                time.sleep(0.02)
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
    text = out.read_text(encoding="utf-8", errors="replace")
    if process.returncode:
        raise AddonError(_error_in(text) or _last_line(err) or f"{words[0]} failed without a word")
    return text


def progress(line: str) -> tuple[float, str]:
    """Fraction of the work that is done, and a text, from a line of the solver's log."""
    step = _STEP.match(line)
    if step is None:
        return 0.0, "preparing (the first run compiles, for about a minute)"
    return int(step[3]) / 100, f"{step[1]}, RMSE {step[2]}"


def _last_line(path: Path) -> str:
    with path.open("rb") as stream:
        stream.seek(max(0, os.path.getsize(path) - 2000))
        lines = stream.read().decode("utf-8", "replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "")


def _error_in(text: str) -> str:
    try:
        return str(json.loads(text)["error"])
    except (ValueError, TypeError, KeyError):
        return ""
