"""The command with a solver that only waits, and the command in a process of its own."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import ssdr
from ssdr.model.frame_error import motion_rms

ROOT = Path(__file__).parents[2]


def model_of(sequence, bones=2, influences=4):
    """Bones at rest, all vertices on the first of them."""
    n = sequence.n_vertices
    transforms = np.zeros((sequence.n_frames, bones, 3, 4))
    transforms[..., :3] = np.eye(3)
    weights = np.zeros((n, influences))
    weights[:, 0] = 1
    return ssdr.Skinning(
        np.asarray(sequence.vertices[0], dtype=np.float64),
        np.zeros((n, influences), dtype=int),
        weights,
        transforms,
        faces=sequence.faces,
        fps=sequence.fps,
        surface=sequence.surface,
        vertex_map=sequence.vertex_map,
    )


def fake_decompose(sequence, *, bones, callback, influences=4, steps=3, pause=0.0, **options):
    """Replacement for the solver with its arguments and results, in this many steps."""
    fake_decompose.options = options
    reason = "converged"
    for step in range(1, steps + 1):
        progress = SimpleNamespace(
            phase="alternate",
            elapsed=pause * step,
            rmse=1.0 / step,
            fraction=step / steps,
            time_left=pause * (steps - step),
        )
        if callback(progress):
            reason = "cancelled"
            break
        if pause and step == 1:
            sys.stderr.write("solving\n")
        time.sleep(pause)
    return ssdr.Decomposition(
        skinning=model_of(sequence, bones, influences),
        rmse=0.25,
        stop_reason=reason,
        history=(),
        offsets=np.array([0, sequence.n_frames]),
        motion=motion_rms([sequence]),
    )


FAKED = textwrap.dedent(
    """
    import functools, sys
    import ssdr, ssdr.cli
    from helpers import command
    fake = functools.partial(command.fake_decompose, steps={steps}, pause={pause})
    ssdr.decompose = fake
    sys.exit(ssdr.cli.main())
    """
)


def faked(steps=3, pause=0.02):
    """Arguments of :func:`start` that run the command with the waiting solver."""
    return ["-c", FAKED.format(steps=steps, pause=pause)]


def start(arguments, *, environment=None, **options):
    variables = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    variables["PYTHONPATH"] = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True} | options
    if os.name == "posix":
        options.setdefault("preexec_fn", _as_from_a_terminal)
    return subprocess.Popen(
        [sys.executable, *map(str, arguments)], env=variables | (environment or {}), **options
    )


def _as_from_a_terminal():
    """Tests that run in the background or under nohup have signals ignored; the command has not."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def through_shell(redirections, arguments, **options):
    """Start the command through a shell that redirects its standard streams."""
    quoted = shlex.join([sys.executable, *map(str, arguments)])
    return start(["-c", _EXEC, f"exec {quoted} {redirections}"], **options)


_EXEC = "import os, sys; os.execvp('sh', ['sh', '-c', sys.argv[1]])"


def wait_for(process, text):
    """Read stderr until a line holds the text."""
    seen = ""
    for line in process.stderr:
        seen += line
        if text in line:
            return
    raise AssertionError(f"{text!r} never came: {seen}")
