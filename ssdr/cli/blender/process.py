"""Child processes that do not block Blender."""

import os
import subprocess
import sys
import time
from collections.abc import Generator
from pathlib import Path


class AddonError(Exception):
    """Error whose message is shown to the user."""


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
        streams = {"stdin": subprocess.DEVNULL, "stdout": stdout, "stderr": stderr}
        try:
            process = subprocess.Popen(words, cwd=folder, env=variables, **streams, **hidden)
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
    if process.returncode:
        raise AddonError(_last_line(err) or f"{words[0]} failed without a word")
    return out.read_text(encoding="utf-8", errors="replace")


def _last_line(path: Path) -> str:
    with path.open("rb") as stream:
        stream.seek(max(0, os.path.getsize(path) - 2000))
        lines = stream.read().decode("utf-8", "replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "")
