"""Implicit smoothing: CHOLMOD against SciPy's SuperLU, time and error side by side.

    python benchmarks/speed/laplacian.py

Spheres of three resolutions, 300 frames each; the frame's x, y, z are solved in one batch.
Errors: residual of the linear system, and distance from the analytic damping
1 / (1 + 2 l²) of the sphere's coordinate functions.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks import common
from ssdr.laplacian.operators import cotangent_laplacian, mass_matrix
from ssdr.laplacian.smoothing import LaplacianSmoother

FRAMES, LENGTH = 300, 0.2


def measure(subdivisions: int, backend: str) -> common.Row:
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    noise = np.random.default_rng(0).normal(size=(FRAMES, len(vertices), 3))
    frames = vertices + 0.02 * noise

    def factor() -> LaplacianSmoother:
        return LaplacianSmoother(vertices, faces, LENGTH, backend=backend)

    smoother = factor()
    mass, laplacian = mass_matrix(vertices, faces), cotangent_laplacian(vertices, faces)
    right = mass @ frames[0]
    left = (mass + LENGTH**2 * laplacian) @ smoother.smooth(frames[0])
    analytic = vertices / (1 + 2 * LENGTH**2)
    return {
        "vertices": len(vertices),
        "factor, s": common.quickest(factor, 3),
        "solve, s": common.quickest(lambda: smoother.smooth(frames), 3),
        "residual": float(np.linalg.norm(left - right) / np.linalg.norm(right)),
        "analytic error": float(np.abs(smoother.smooth(vertices) - analytic).max()),
    }


if __name__ == "__main__":
    cases = {
        f"{backend} {n}": {"subdivisions": n, "backend": backend}
        for n in (4, 5, 6)
        for backend in ("cholmod", "scipy")
    }
    columns = ("vertices", "factor, s", "solve, s", "residual", "analytic error")
    common.run(__file__, __doc__, cases, measure, columns)
