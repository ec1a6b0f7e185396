"""Animations by name: those of the data folders, samples, and made ones.

``tube:V:F`` has about V vertices and F frames; ``chain`` is exact skinning; ``flag``, ``skirt`` and
``sail`` are thin, smooth sheets.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks import common


def tube(vertices: int, frames: int, joints: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """A tube on a chain that swings, with waves that travel along it: of full rank."""
    around = max(8, round((vertices / 8) ** 0.5))
    rings = max(4, round(vertices / around))
    along = np.linspace(0.0, joints, rings)
    angle = np.linspace(0.0, 2 * np.pi, around, endpoint=False)
    x, a = (m.ravel() for m in np.meshgrid(along, angle, indexing="ij"))
    rng = np.random.default_rng(3)
    clock = np.arange(frames)[:, None] / 24.0
    out = np.empty((frames, len(x), 3))
    speed, phase = rng.uniform(1, 4, joints), rng.uniform(0, 6.28, joints)
    curvature = np.sin(clock * speed + phase)  # along each link
    share = np.clip(along[:, None] - np.arange(joints), 0, 1)  # of each link that lies behind
    bend = 0.5 * curvature @ share.T
    dx = np.diff(along, prepend=0.0)
    px, py = np.cumsum(np.cos(bend) * dx, axis=1), np.cumsum(np.sin(bend) * dx, axis=1)
    ring = np.repeat(np.arange(rings), around)
    radius = 0.4 * (1 + 0.04 * np.sin(5 * x - 7 * clock + 2 * a))
    side, up = radius * np.cos(a), radius * np.sin(a)
    out[..., 0] = px[:, ring] - np.sin(bend)[:, ring] * side
    out[..., 1] = py[:, ring] + np.cos(bend)[:, ring] * side
    out[..., 2] = up + 0.002 * rng.standard_normal(up.shape)
    i, k = np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij")
    p, q = (i * around + k).ravel(), (i * around + (k + 1) % around).ravel()
    faces = np.concatenate([np.c_[p, q, q + around], np.c_[p, q + around, p + around]])
    return out.astype(np.float32), faces.astype(np.int32)


def chain(bones: int = 6, frames: int = 60, seed: int = 7) -> np.ndarray:
    """A tube of 80 rings of 16 vertices on a chain of joints that swing and twist."""
    rng = np.random.default_rng(seed)
    along = np.linspace(0.0, bones, 80)
    angle = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
    x, a = (m.ravel() for m in np.meshgrid(along, angle, indexing="ij"))
    rest = np.stack([x, 0.35 * np.cos(a), 0.25 * np.sin(a)], axis=1)
    dense = np.exp(-(((x[:, None] - np.arange(bones) - 0.5) / 0.8) ** 2))
    indices = np.argsort(-dense, axis=1, kind="stable")[:, :4]
    weights = np.take_along_axis(dense, indices, axis=1)
    weights[weights < 0.01] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    phase, speed = rng.uniform(0, 2 * np.pi, (bones, 3)), rng.uniform(1.0, 4.0, (bones, 3))
    clock = np.arange(frames)[:, None, None] / 24.0
    swing = np.sin(clock * speed + phase) * np.array([0.3, 0.4, 0.5])
    transforms = np.empty((frames, bones, 3, 4))
    for t in range(frames):
        world = np.eye(4)
        for j, turn in enumerate(Rotation.from_euler("XYZ", swing[t]).as_matrix()):
            local, pivot = np.eye(4), np.array([j, 0.0, 0.0])
            local[:3, :3], local[:3, 3] = turn, pivot - turn @ pivot
            world = world @ local
            transforms[t, j] = world[:3]
    return common.reskin(rest, indices, weights, transforms)


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


def load(name: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Frames (F, V, 3) and faces (T, 3); None where there is no surface."""
    if name.startswith("tube:"):
        vertices, frames = map(int, name.split(":")[1:])
        return tube(vertices, frames)
    if name == "chain":
        return chain(), None
    return SHEETS[name]() if name in SHEETS else common.load(name)


def is_made(name: str) -> bool:
    return name == "chain" or name in SHEETS or name.startswith("tube:")
