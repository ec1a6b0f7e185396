"""Creases of soft garments by cut: what a constant vector for each vertex leaves, and chaos.

How the data set `soft_dress` was chosen; each row takes about a minute of one core::

    python benchmarks/garment/cuts.py

The first seconds of two dances are simulated, one of them also from a start moved by 0.1 mm.  Of
the detail (what the smoother of 20 mm takes away, turned with the smoothed surface, free vertices)
is printed what its mean over the clip itself leaves and what that over the other clip leaves, and
RMSE / √2 between the two starts, second by second.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


from benchmarks.garment.detail import rms
from garmentnet.data.parameters import SimulationParameters
from garmentnet.scenes.body import default_body
from garmentnet.scenes.cloth import Cloth, Solver
from garmentnet.scenes.cut import Cut, cut_garment
from garmentnet.scenes.dance.choreography import dance
from garmentnet.scenes.garments import Garment
from garmentnet.scenes.simulator import simulate
from ssdr.laplacian import LaplacianSmoother

SEEDS, FIRST, FRAMES, LENGTH, MOVED = (20000, 20002), 60, 600, 0.02, 1e-4
FINE = {"vertices": 12273, "pleats": 0, "pleat_depth": 0.0}
# Cut, and flexural rigidity where the parameter `bending` is 1, N·m.
VARIANTS: dict[str, tuple[dict[str, Any], float]] = {
    "dress": ({"vertices": 2100}, 1e-3),
    "a_line, soft": ({**FINE, "flare": 0.22, "hem": 0.30}, 1e-4),
    "flare 0.42": ({**FINE, "flare": 0.42}, 1e-4),
    "flare 0.28": ({**FINE, "flare": 0.28, "hem": 0.26}, 2e-4),
    "long": ({**FINE, "flare": 0.22, "hem": 0.20}, 1e-4),
    "bust, flare 0.24": ({**FINE, "flare": 0.24, "hem": 0.28, "pinned": 0.68}, 1e-4),
    "bust, flare 0.28": ({**FINE, "flare": 0.28, "hem": 0.26, "pinned": 0.68}, 2e-4),
    "bust, flare 0.26": ({**FINE, "flare": 0.26, "hem": 0.255, "pinned": 0.68}, 1e-4),
}
Array = np.ndarray


class Turns:
    """Frames that turn with a surface: its derivatives in two directions, made orthonormal."""

    def __init__(self, garment: Garment) -> None:
        rest, n = garment.rest.astype(float), garment.n_vertices
        pairs = garment.edges()
        i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
        corner = rest[garment.faces]
        across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal = np.zeros_like(rest)
        np.add.at(normal, garment.faces.ravel(), np.repeat(across, 3, axis=0))
        one = np.cross(normal, [0.3, 0.9, 0.1])
        one /= np.linalg.norm(one, axis=1, keepdims=True)
        two = np.cross(normal, one)
        two /= np.linalg.norm(two, axis=1, keepdims=True)
        edge = rest[j] - rest[i]
        plane = np.stack([(edge * one[i]).sum(1), (edge * two[i]).sum(1)], axis=1)
        square = np.zeros((n, 2, 2))
        np.add.at(square, i, plane[:, :, None] * plane[:, None])
        slopes = np.linalg.solve(square[i], plane[:, :, None])[..., 0]
        self.operators = [
            csr_array((np.append(s, -s), (np.append(i, i), np.append(j, i))), (n, n))
            for s in slopes.T
        ]

    def __call__(self, vertices: Array) -> Array:
        """Rotations ``(F, V, 3, 3)`` of the surface, up to a constant one at each vertex."""
        f, v, _ = vertices.shape
        flat = vertices.transpose(1, 0, 2).reshape(v, -1)
        a, b = (unit((d @ flat).reshape(v, f, 3).transpose(1, 0, 2)) for d in self.operators)
        x, y = unit(a + b), unit(a - b)
        return np.stack([x, y, np.cross(x, y)], axis=-1)


def unit(x: Array) -> Array:
    return np.asarray(x / np.linalg.norm(x, axis=-1, keepdims=True))


def measure(cut: Cut, solver: Solver, frames: int) -> list[str]:
    body = default_body()
    garment = cut_garment(body, cut)
    cloth, turns = Cloth(body, garment, solver), Turns(garment)
    smoother = LaplacianSmoother(garment.rest, garment.faces, LENGTH)
    free, used, stretch = ~garment.pinned, 0.0, 0.0

    def local(seed: int, moved: float = 0.0) -> Array:
        nonlocal used, stretch
        motion = dance(body.skeleton, seed=seed, frames=FRAMES).cut(FIRST, FIRST + frames)
        began = time.process_time()
        found = simulate(cloth, motion, SimulationParameters(), perturbation=moved)
        used += time.process_time() - began
        stretch = max(stretch, found.quality.stretch_p99)
        low = np.asarray(smoother.smooth(found.vertices), np.float64)
        high = found.vertices - low
        return np.einsum("fvji,fvj->fvi", turns(low), high)[:, free]

    details = [local(seed) for seed in SEEDS]
    gap = local(SEEDS[1], MOVED) - details[1]
    means = [d.mean(axis=0) for d in details]
    own = [rms(d - m) / rms(d) for d, m in zip(details, means, strict=True)]
    other = [rms(d - m) / rms(d) for d, m in zip(details, means[::-1], strict=True)]
    left = np.mean([rms(d - m) for d, m in zip(details, means, strict=True)])
    floors = [rms(gap[t : t + 30]) / np.sqrt(2) for t in range(30, frames, 30)]
    count = (len(SEEDS) + 1) * (frames + solver.approach + solver.settle)
    return [
        f"{rms(details[1]):.1f}",
        f"{100 * np.mean(own):.0f} %",
        f"{100 * np.mean(other):.0f} %",
        f"{left:.1f}",
        " ".join(f"{x:.1f}" for x in floors),
        f"{stretch:.2f}",
        f"{1e3 * used / count:.0f}",
    ]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--frames", type=int, default=120)
    options.add_argument("variants", nargs="*", help="some of the variants")
    given = options.parse_args()
    print("| | detail, mm | own mean leaves | other's | mm | chaos, mm | stretch p99 | ms |")
    print("|---" * 8 + "|")
    for name in given.variants or VARIANTS:
        changes, bending = VARIANTS[name]
        cut = Cut(**changes)
        substeps = 60 if cut.vertices > 10_000 else 40
        solver = Solver(substeps=substeps, bending=bending, settle=25)
        print(f"| {name} | {' | '.join(measure(cut, solver, given.frames))} |", flush=True)


if __name__ == "__main__":
    main()
