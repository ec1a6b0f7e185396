"""Test meshes, and assertions that two sequences or surfaces are equal."""

from __future__ import annotations

import dataclasses

import numpy as np
import trimesh

from helpers import motions


def same_sequence(a, b, *, strict=True):
    np.testing.assert_array_equal(a.vertices[:], b.vertices[:], strict=strict)
    np.testing.assert_array_equal(a.faces, b.faces, strict=True)
    assert a.fps == b.fps


def same_surface(a, b):
    for field in ("uv", "normals", "material_index"):
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field), strict=True)
    assert [dataclasses.asdict(m) for m in a.materials] == [
        dataclasses.asdict(m) for m in b.materials
    ]


def sphere(subdivisions=2):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32)


def grid(n, m, *, jitter=0.0, rng=None, size=1.0):
    """A flat patch of (n+1)(m+1) vertices, triangulated, inner vertices moved in the plane."""
    x, y = np.meshgrid(np.linspace(0, size, n + 1), np.linspace(0, size, m + 1), indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    if jitter:
        points[1:-1, 1:-1, :2] += jitter * rng.uniform(-1, 1, (n - 1, m - 1, 2))
    return points.reshape(-1, 3), motions.grid(n + 1, m + 1).astype(np.int32)


def animation(seed=0, *, F=5, noise=0.1, subdivisions=1):
    rng = np.random.default_rng(seed)
    vertices, faces = sphere(subdivisions)
    frames = vertices + np.cumsum(noise * rng.normal(size=(F, len(vertices), 3)), axis=0)
    return frames, faces
