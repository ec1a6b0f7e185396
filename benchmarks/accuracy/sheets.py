"""What a length given as `normals` does: thin, smooth sheets, and sequences of the other tables.

    python benchmarks/accuracy/sheets.py

Beside the RMSE in percent of the diagonal stand the mean angle, in degrees, between the normals
that engines draw and those of the input, and the seconds of one thread.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import ssdr
from benchmarks import common
from benchmarks.common import Row

CASES = [
    ("flag", 4), ("flag", 8), ("flag", 12), ("skirt", 16), ("sail", 12),
    ("ea_bone", 20), ("mannequin_rumba", 30),
]  # fmt: skip


def triangles(n: int, m: int, *, closed: bool = False) -> np.ndarray:
    """Triangles of a grid of n × m vertices; the first and last of n meet if `closed`."""
    i = np.arange(n * m).reshape(n, m)
    j = np.roll(i, -1, 0) if closed else i[1:]
    a, b, c, d = (x.ravel() for x in (i[: len(j), :-1], j[:, :-1], j[:, 1:], i[: len(j), 1:]))
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def flag(n: int = 31, m: int = 21, count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Waves travel from the pole."""
    s, y = (a.ravel() for a in np.meshgrid(np.linspace(0, 1.5, n), np.linspace(-0.5, 0.5, m)))
    s, y = s.reshape(m, n).T.ravel(), y.reshape(m, n).T.ravel()
    frames = []
    for t in np.linspace(0, 2 * np.pi, count, endpoint=False):
        x = s - 0.75 - 0.06 * s**2 * (1 + np.sin(2 * t))
        z = 0.18 * s * np.sin(6 * s - 2 * t + 1.5 * y)
        frames.append(np.stack([x, y + 0.03 * s * np.cos(3 * t), z], -1))
    return np.array(frames), triangles(n, m)


def skirt(n: int = 48, m: int = 20, count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """It swings and twists, with folds that travel around it."""
    a, h = np.linspace(0, 2 * np.pi, n, endpoint=False)[:, None], np.linspace(0, 1, m)[None]
    frames = []
    for t in np.linspace(0, 2 * np.pi, count, endpoint=False):
        lag = t - 0.8 * h
        turn = a + 0.5 * h * np.sin(lag) + 0.25 * np.sin(t)
        fold = 0.06 * h * np.sin(7 * a + 2 * np.sin(lag) * h - t)
        r = 0.25 + 0.45 * h * (1 + 0.12 * np.cos(2 * lag)) + fold
        x = r * np.cos(turn) + 0.3 * h**1.5 * np.sin(lag)
        y = r * np.sin(turn) + 0.15 * h**1.5 * np.sin(2 * lag)
        z = -0.9 * h + 0.1 * h * np.cos(lag) * np.cos(a)
        frames.append(np.stack([x, y, z], -1).reshape(-1, 3))
    return np.array(frames), triangles(n, m, closed=True)


def sail(n: int = 36, m: int = 28, count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """On a boom that swings, it fills and spills, and flutters at its free edge."""
    u, w = (a.T for a in np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, m)))
    frames = []
    for t in np.linspace(0, 2 * np.pi, count, endpoint=False):
        along = 1.6 * u * (1 - 0.85 * w)
        full = 0.88 * np.sin(t) * u * (1 - u) * np.sin(np.pi * (0.15 + 0.85 * w))
        full = full + 0.05 * u**2 * np.sin(9 * u + 4 * w - 3 * t)
        boom = 0.5 * np.sin(t + 0.3) + 0.35 * w * np.sin(t - 0.6)
        x = along * np.cos(boom) - full * np.sin(boom)
        y = along * np.sin(boom) + full * np.cos(boom)
        z = 2 * w + 0.08 * u * (1 - w) * np.cos(t)
        frames.append(np.stack([x, y, z], -1).reshape(-1, 3))
    return np.array(frames), triangles(n, m)


SHEETS = {"flag": flag, "skirt": skirt, "sail": sail}


def measure(sequence: str, bones: int, normals: Any) -> Row:
    frames, faces = SHEETS[sequence]() if sequence in SHEETS else common.load(sequence)
    mesh = ssdr.MeshSequence(frames, faces)
    common.compile_kernels()
    began = time.process_time()
    result = ssdr.decompose(mesh, bones=bones, normals=normals)
    seconds = time.process_time() - began
    assert result.normals is not None
    return {
        "percent": 100 * result.rmse / mesh.diagonal(),
        "drawn": result.normals.mean,
        "cpu seconds": seconds,
    }


if __name__ == "__main__":
    cases = {
        f"{sequence}-{bones} {normals}": {"sequence": sequence, "bones": bones, "normals": normals}
        for sequence, bones in CASES
        for normals in (True, "0.05%")
    }
    common.run(__file__, __doc__, cases, measure, ("percent", "drawn", "cpu seconds"))
