"""A model that pictures are drawn of."""

from __future__ import annotations

import numpy as np
import pytest

import ssdr


@pytest.fixture
def model(wave, rng):
    """Two bones that turn apart, blended over the grid; rest normals of its own at each vertex."""
    x = wave.vertices[0, :, 0].astype(np.float64) / 2
    turn = np.linspace(0, 1.2, wave.n_frames)
    transforms = np.tile(np.eye(3, 4), (wave.n_frames, 2, 1, 1))
    transforms[:, 1, 0, 0] = transforms[:, 1, 2, 2] = np.cos(turn)
    transforms[:, 1, 2, 0] = np.sin(turn)
    transforms[:, 1, 0, 2] = -np.sin(turn)
    weights = np.stack([1 - x, x], axis=1)
    normals = rng.normal(size=(len(x), 3)) * 0.3 + [0, 0, 1]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    surface = ssdr.Surface(normals=normals[wave.faces].astype(np.float32))
    skin = np.tile([0, 1], (len(x), 1)), weights, transforms
    return ssdr.Skinning(wave.vertices[0], *skin, faces=wave.faces, fps=wave.fps, surface=surface)
