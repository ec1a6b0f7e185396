"""Implicit smoothing: CHOLMOD against SciPy's SuperLU, time and error side by side.

    python benchmarks/speed/laplacian.py --out out/laplacian

Spheres of three resolutions, 300 frames each; the frame's x, y, z are solved in one batch.
Errors: residual of the linear system, and distance from the analytic damping
1 / (1 + 2 l^2) of the sphere's coordinate functions.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

from ssdr.laplacian.operators import cotangent_laplacian, mass_matrix
from ssdr.laplacian.smoothing import LaplacianSmoother

FRAMES, LENGTH = 300, 0.2


def seconds(function: Callable[[], object], repeats: int = 3) -> float:
    best = float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        best = min(best, time.perf_counter() - start)
    return best


def measure(subdivisions: int, backend: str) -> dict[str, float | int | str]:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    noise = np.random.default_rng(0).normal(size=(FRAMES, len(vertices), 3))
    frames = vertices + 0.02 * noise
    smoother = LaplacianSmoother(vertices, faces, LENGTH, backend=backend)
    mass, laplacian = mass_matrix(vertices, faces), cotangent_laplacian(vertices, faces)
    right = mass @ frames[0]
    left = (mass + LENGTH**2 * laplacian) @ smoother.smooth(frames[0])
    analytic = vertices / (1 + 2 * LENGTH**2)
    return {
        "backend": backend,
        "vertices": len(vertices),
        "factor_s": seconds(lambda: LaplacianSmoother(vertices, faces, LENGTH, backend=backend)),
        "solve_s": seconds(lambda: smoother.smooth(frames)),
        "residual": float(np.linalg.norm(left - right) / np.linalg.norm(right)),
        "analytic_error": float(np.abs(smoother.smooth(vertices) - analytic).max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/laplacian"))
    out: Path = parser.parse_args().out
    rows = [measure(n, backend) for n in (4, 5, 6) for backend in ("cholmod", "scipy")]
    out.parent.mkdir(parents=True, exist_ok=True)
    out.with_suffix(".json").write_text(json.dumps(rows, indent=1) + "\n")
    for row in rows:
        print(
            "  ".join(
                f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()
            )
        )
    draw(rows, out.with_suffix(".png"))


def draw(rows: list[dict[str, float | int | str]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for backend, colour in (("cholmod", "tab:blue"), ("scipy", "tab:orange")):
        mine = [row for row in rows if row["backend"] == backend]
        sizes = [row["vertices"] for row in mine]
        axes[0].loglog(
            sizes,
            [r["factor_s"] for r in mine],
            "o--",
            color=colour,
            label=f"{backend}, assemble and factor",
        )
        axes[0].loglog(
            sizes,
            [r["solve_s"] for r in mine],
            "o-",
            color=colour,
            label=f"{backend}, {FRAMES} frames",
        )
        axes[1].loglog(sizes, [r["residual"] for r in mine], "o-", color=colour, label=backend)
    axes[0].set(xlabel="vertices", ylabel="seconds", title="time")
    axes[1].set(xlabel="vertices", ylabel="relative residual", title="error")
    for axis in axes:
        axis.set_xticks(sizes, [str(n) for n in sizes])
        axis.minorticks_off()
        axis.legend(fontsize=8)
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    main()
